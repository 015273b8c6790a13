"""From pixels to disks: plain arrays, pixel lengths, no files."""
