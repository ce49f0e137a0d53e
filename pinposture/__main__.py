"""Runs the command as `python -m pinposture`."""

from __future__ import annotations

from pinposture.cli import main

if __name__ == "__main__":
    main()
