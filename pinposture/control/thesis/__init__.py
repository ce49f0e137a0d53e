"""The methods of the thesis: Selection (Chapter 4), Projection (Chapter 5), Switching (Section 4.6.2)."""
