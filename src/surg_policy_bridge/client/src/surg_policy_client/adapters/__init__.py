"""Policies of other projects, as policies of ours: docs/policy_client.md says what was tested."""
