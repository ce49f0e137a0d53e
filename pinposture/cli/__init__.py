"""The `pinposture` command: each verb reads its arguments, calls the library, and prints the result."""

from pinposture.cli.app import app, main

__all__ = ["app", "main"]
