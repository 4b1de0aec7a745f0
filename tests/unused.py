"""Names that vulture must not take for dead code: arguments that a caller of ours hands in, needed or not."""
# ruff: noqa: B018, F821

context  # click: Command.format_epilog
unused  # Cyclone DDS: of the methods that it calls of a message's class
