"""What leaving out an effect of the mechanics changes."""
