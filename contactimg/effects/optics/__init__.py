"""What leaving out an effect of optics or sensor changes."""
