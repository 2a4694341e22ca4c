"""Thread in hole: the task, its figure, its thread and its scripted sender."""
