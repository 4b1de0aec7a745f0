"""Names that vulture must not take for dead code: what others call, read or set, by these names."""
# ruff: noqa: B018, F821

context, format_epilog, format_usage, get_command, list_commands  # click
__getattr__, __dir__, __signature__, __cause__, __context__, _repr_html_, _repr_svg_  # Python and notebooks
writeable, comment, compress_type, max_size, should_exit  # NumPy, zipfile, websockets, uvicorn
run_map, run_localize, run_doctor  # targets of jobs, which are text
(
    comments,
    jumps,
    refused,
    throttled,
    extrapolated,
    surplus,
    odometry_m,
    runner_up_pose,
)  # read together with others
to_planar, read_trajectory_csv  # offered to callers
