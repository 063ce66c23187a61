"""File formats of worlds, in and out: map_server, wall lists, HouseExpo."""
