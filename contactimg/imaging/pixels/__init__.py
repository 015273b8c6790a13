"""Images as arrays: means over blocks, filters, robust statistics, masks."""
