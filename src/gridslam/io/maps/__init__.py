"""Maps in the format of map_server."""
