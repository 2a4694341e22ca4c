"""What `./surg learn` does: recipes, stages, roll-outs of the learned policy."""
