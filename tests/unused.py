"""Names that vulture must not take for dead code: what others call, read or set, by these names."""
# ruff: noqa: B018, F821

context, format_epilog, format_usage, get_command, list_commands  # click
__getattr__, __dir__, __signature__, __cause__, __context__, unraisablehook, _repr_svg_  # Python and notebooks
(
    align_to_folder,
    changes_to_folder,
    doctor_log,
    evaluate,
    get_dataset,
    graph_to_folder,
    grid_to_folder,
    landmarks_to_folder,
    list_datasets,
    localize_to_folder,
    map_to_folder,
    mask_to_folder,
    merge_to_folder,
    plan_to_folder,
    regress,
    ros1,
    ros2,
    show_session,
    simulate_to_log,
)  # code of commands, which their help names in text
writeable, comment, compress_type, max_size, should_exit  # NumPy, zipfile, websockets, uvicorn
(
    comments,
    jumps,
    refused,
    throttled,
    extrapolated,
    surplus,
    runner_up_pose,
)  # read together with others
read_trajectory_csv  # offered to callers
