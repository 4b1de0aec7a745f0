"""The node, independent of the transport of its messages."""
