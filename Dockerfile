# cyclekit from this folder, in a container; the folder of a project is mounted as /data:
#
#   docker build -t cyclekit .
#   docker run --rm -v "$PWD:/data" cyclekit init logs --yes
#   docker run --rm -v "$PWD:/data" cyclekit run
#
# On Linux add --user "$(id -u):$(id -g)" to `docker run`, so that the results are your files and not root's.
#
# --build-arg PYTHON=...     another base image that holds Python 3.11 or newer and pip
# --build-arg EXTRAS=all     other extras (docs/commands.md#extras)
# --build-arg PIP_FLAGS=...  another package index (a CPU-only torch saves gigabytes)
ARG PYTHON=python:3.11-slim
FROM ${PYTHON}
ARG EXTRAS=train,excel
ARG PIP_FLAGS=
COPY . /src
RUN pip install --no-cache-dir ${PIP_FLAGS} -c /src/constraints.txt "/src[${EXTRAS}]" && rm -r /src
ENV MPLCONFIGDIR=/tmp/matplotlib
WORKDIR /data
ENTRYPOINT ["cyclekit"]
CMD ["--help"]
