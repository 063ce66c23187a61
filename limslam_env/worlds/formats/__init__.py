"""File formats of worlds: TOML, map_server, wall lists and HouseExpo; ``loading`` reads any of
them.
"""
