"""Example policies: ``python -m surg_policy_client.policies.NAME --server ADDRESS``."""
