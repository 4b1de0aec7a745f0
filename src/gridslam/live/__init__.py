"""A web page that shows a running filter or a finished run.

`gridslam.live.page` shows a running filter, `gridslam.live.replay` a finished run, served by `gridslam.live.server`.
`gridslam.live.options` imports nothing heavy.
"""
