"""`python -m pinposture.study DIRECTORY` writes the robot descriptions of the thesis's arms."""

import sys

from pinposture.study.scenarios import main

sys.exit(main(sys.argv[1:]))
