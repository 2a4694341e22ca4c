"""Learning from demonstrations: the stages of `./surg learn`, and one folder for each task."""
