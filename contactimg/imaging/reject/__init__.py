"""What stands out of the background and is no contact."""
