"""`./surg policy …`: what a policy needs before it connects."""
