"""Task files, written: what stands in them for a task, laid out as a person would."""
