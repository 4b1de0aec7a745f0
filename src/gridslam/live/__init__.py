"""The map in the browser while it grows, and a finished run again.

`gridslam.live.page` has what shows a run of the filter, `gridslam.live.replay` what shows its results; importing them
costs the import of the web server. `gridslam.live.options` costs nothing.
"""
