# panobench for processors: the wheel is built in one stage and installed in another.
#
#   docker build -t panobench .
#   docker run --rm -v "$PWD:/work" panobench run --out runs/first
#   docker run --rm -v "$PWD:/work" panobench report runs/first -o report.html
#
# Plain builds of torch bring CUDA, some gigabytes. For a smaller image name an index that has builds for processors:
#   docker build --build-arg PIP_EXTRA_INDEX_URL=... -t panobench .
FROM python:3.12-slim-bookworm AS build
WORKDIR /source
RUN pip install --no-cache-dir "build==1.*"
COPY pyproject.toml README.md LICENSE ./
COPY panobench panobench
RUN python -m build --wheel --outdir /wheels

FROM python:3.12-slim-bookworm
# extras to install, as in "[mesh,onnx,parquet]"
ARG EXTRAS=""
ARG PIP_EXTRA_INDEX_URL=""
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# numba runs loops in parallel through OpenMP
RUN apt-get update \
    && apt-get install -y --no-install-recommends libgomp1=12.* \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir "$(echo /wheels/panobench-*.whl)${EXTRAS}" && rm -r /wheels
# Compiled kernels and rooms are kept here: a volume on it saves a minute at the next start.
ENV NUMBA_CACHE_DIR=/cache/numba PANOBENCH_CACHE=/cache/rooms MPLCONFIGDIR=/cache/matplotlib
RUN useradd --uid 10001 --create-home panobench && mkdir -p /cache /work && chown 10001 /cache /work
USER 10001
WORKDIR /work
ENTRYPOINT ["panobench"]
CMD ["--help"]
