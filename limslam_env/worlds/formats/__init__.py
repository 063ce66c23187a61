"""File formats of worlds: TOML, map_server, wall lists, HouseExpo, pictures, SVG and DXF;
``loading`` reads any of them.
"""
