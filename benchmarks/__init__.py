"""The evidence for what the library claims: cases, studies, the experiments of the thesis, other programs."""
