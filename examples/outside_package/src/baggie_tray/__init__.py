"""A task and a policy for Baggie."""
