"""The published method: scan buffers, association, loop closing."""
