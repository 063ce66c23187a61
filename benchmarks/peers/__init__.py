"""Explorers on the maps of other work on exploration, with its sensor and true pose, and with six beams."""
