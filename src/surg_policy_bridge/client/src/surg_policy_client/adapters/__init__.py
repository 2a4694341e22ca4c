"""Adapters for policies of other projects; docs/guide/policy_client.md lists what is tested."""
