"""What a difference image says of itself: its noise with its correlation, and the polarity of the contacts.

Read `noise` first; `polarity` decides whether contacts are bright or dark.
"""
