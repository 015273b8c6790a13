"""Which effects a scene calls for, each with the number that decides."""
