"""What the contacts of several runs say together."""
