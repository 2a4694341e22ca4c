"""`./surg dev …`: set up, build, test and examine the workspace."""
