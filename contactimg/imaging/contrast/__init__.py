"""Contrast of the contacts: noise, polarity, plateau."""
