"""The default controller in three stages: plan a path, retime it within limits, follow it step by step."""
