"""One HTML page on which a world is drawn."""
