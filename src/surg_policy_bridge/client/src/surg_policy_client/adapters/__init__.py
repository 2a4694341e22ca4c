"""Adapters for policies of other projects; docs/guide/policy_client.md says what was tested."""
