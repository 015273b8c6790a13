"""The method "disk": blurred disks fitted to the pixels."""
