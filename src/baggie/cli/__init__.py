"""The `baggie` command."""
