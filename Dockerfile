# On CPUs: docker build --tag uavaccel .                       On an NVIDIA GPU too: add --build-arg DEVICE=cuda
# docker run --rm --publish 8080:8080 uavaccel watch --host 0.0.0.0
ARG PYTHON=3.11
FROM python:${PYTHON}-slim-bookworm

# Debian keeps one version of a package.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libegl-mesa0 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

ARG DEVICE=cpu
COPY . /src
WORKDIR /src
# PyTorch's own wheel on PyPI carries CUDA; with it goes the extra for the kernels on a GPU.
RUN --mount=type=cache,target=/root/.cache/pip if [ "$DEVICE" = cuda ]; then extra='[film,learn,gpu]'; \
       else extra='[film,learn]'; export PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu; fi \
    && pip install "$(grep '^torch==' constraints.txt)" \
    && pip install --constraint constraints.txt ".$extra"

ENV NVIDIA_DRIVER_CAPABILITIES=compute,graphics,utility
RUN useradd --create-home --uid 1000 uavaccel
USER 1000
WORKDIR /home/uavaccel
# Compiles the hot loop into numba's cache, and says at the build what the image lacks.
RUN uavaccel doctor
ENTRYPOINT ["uavaccel"]
CMD ["--help"]
