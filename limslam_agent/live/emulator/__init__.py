"""A simulated robot that speaks the line protocol, behind a serial port or a UDP socket."""
