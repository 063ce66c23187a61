"""Map merging: two logs of one building with an unknown relative start become one graph of local maps."""
