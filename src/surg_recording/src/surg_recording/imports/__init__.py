"""Episode folders from recordings that another program made: bags and LeRobot data sets."""
