"""Arms, starts, targets and obstacles of the studies."""
