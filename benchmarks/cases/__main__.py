"""`python -m benchmarks.cases DIRECTORY` writes the robot descriptions of the thesis's arms."""

import sys

from benchmarks.cases.scenarios import main

sys.exit(main(sys.argv[1:]))
