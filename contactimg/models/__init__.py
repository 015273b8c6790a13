"""Multi-asperity contact models."""
