# Two images, for x86-64 and ARM (docker buildx build --platform linux/amd64,linux/arm64 .):
#
#   docker build -t gridslam .                                slim: the command line
#   docker build -t gridslam-ros --target ros .               ROS 2's own image: the node
#
# Both run as a user without rights, in /work:
#
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/work" gridslam map log.bag -o out
ARG BASE=python:3.12-slim-bookworm
ARG ROS_DISTRO=jazzy
ARG ROS_BASE=ros:${ROS_DISTRO}-ros-core

FROM ${ROS_BASE} AS ros-build
RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ python3-dev python3-numpy python3-venv \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml CMakeLists.txt README.md LICENSE ./
COPY src src
# rclpy's messages are compiled for the NumPy of ROS, whose major version is kept.
RUN python3 -m venv --system-site-packages /opt/gridslam \
    && major="$(python3 -c 'import numpy; print(numpy.__version__.split(".")[0])')" \
    && /opt/gridslam/bin/pip install --no-cache-dir . "numpy<$((major + 1))" \
    && /opt/gridslam/bin/python -c 'import sys; from gridslam.kernels import compiled; sys.exit(not compiled)'

FROM ${ROS_BASE} AS ros
ARG UID=10001
RUN apt-get update \
    && apt-get install --yes --no-install-recommends "ros-${ROS_DISTRO}-tf2-msgs" python3-numpy \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --non-unique --uid "${UID}" --create-home gridslam \
    && mkdir /work \
    && chown gridslam /work
COPY --from=ros-build /opt/gridslam /opt/gridslam
ENV PATH=/opt/gridslam/bin:$PATH
USER gridslam
WORKDIR /work
EXPOSE 8642
ENTRYPOINT ["/ros_entrypoint.sh", "gridslam"]
CMD ["ros2", "--live", "-o", "gridslam-map"]

FROM ${BASE} AS build
RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml CMakeLists.txt README.md LICENSE ./
COPY src src
# Nothing but gridslam itself is compiled.
RUN python3 -m venv /opt/gridslam \
    && /opt/gridslam/bin/pip wheel --no-cache-dir --no-deps --wheel-dir /wheels . \
    && /opt/gridslam/bin/pip install --no-cache-dir --only-binary :all: /wheels/*.whl \
    && /opt/gridslam/bin/python -c 'import sys; from gridslam.kernels import compiled; sys.exit(not compiled)'

FROM ${BASE}
ARG UID=10001
RUN useradd --non-unique --uid "${UID}" --create-home gridslam \
    && mkdir /work \
    && chown gridslam /work
COPY --from=build /opt/gridslam /opt/gridslam
ENV PATH=/opt/gridslam/bin:$PATH
USER gridslam
WORKDIR /work
EXPOSE 8642
ENTRYPOINT ["gridslam"]
CMD ["--help"]
