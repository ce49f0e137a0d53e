"""Task files: what they may say, and what is made of it."""
