"""Studies over many starts, targets and arms."""
