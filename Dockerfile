# A worker for `armsight batch`: docs/guide/batch.md says how a scheduler and workers are started from it.
# The base is any image with Python 3.11 to 3.13 on a Debian; give another by --build-arg BASE=...
ARG BASE=docker.io/library/python:3.11-slim-bookworm

FROM ${BASE} AS build
WORKDIR /source
RUN python3 -m venv /opt/armsight
COPY requirements-worker.lock ./
RUN /opt/armsight/bin/pip install --no-cache-dir --require-hashes -r requirements-worker.lock
COPY pyproject.toml README.md CHANGELOG.md LICENSE ./
COPY src src
COPY sim sim
COPY lab lab
RUN /opt/armsight/bin/pip install --no-cache-dir --no-deps --no-build-isolation . ./sim ./lab

FROM ${BASE}
# BLAS and OpenMP would each take all cores in every worker
ENV PATH=/opt/armsight/bin:$PATH \
    NUMBA_CACHE_DIR=/var/cache/armsight \
    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1
RUN useradd --create-home --uid 10001 worker \
 && install --directory --owner worker --group worker /var/cache/armsight /data
COPY --from=build /opt/armsight /opt/armsight
USER worker
WORKDIR /data
# for the processor that builds the image; another compiles its own into the same folder when it first needs them
RUN python3 -m armsight.ops.compilation
EXPOSE 8786 8787
ENTRYPOINT ["dask"]
CMD ["worker", "--help"]
