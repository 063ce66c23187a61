"""Live robots: the line protocol, serial ports and UDP, and the session that drives a robot and
records it.
"""
