"""The method "threshold": pixels counted above a fraction of the contrast."""
