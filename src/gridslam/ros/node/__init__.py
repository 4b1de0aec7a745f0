"""The node: what it does, whatever carries its messages."""
