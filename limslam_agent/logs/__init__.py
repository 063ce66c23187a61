"""Readers of recorded logs. ``log_reader.read_log`` opens every supported format."""
