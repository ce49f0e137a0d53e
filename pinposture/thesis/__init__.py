"""The arms, curves and scenarios of the thesis, as data."""
