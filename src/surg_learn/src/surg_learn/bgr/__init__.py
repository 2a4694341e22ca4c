"""Bowel grasping and retraction: policies, and the programs `train_…` that train them."""
