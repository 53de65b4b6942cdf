# The image of one distribution and what it needs, such as `--build-arg DISTRIBUTION=handover-broker`. Without it, the
# command line of a cell: `handover secure`, `backup`, `doctor`.
#
# Behind a mirror or a proxy, the configuration of pip and npm and the certificates are build secrets, so that the
# image does not contain them: deploy/README.md shows how.

ARG BASE=python:3.12-slim
ARG DISTRIBUTION=handover-cell

# The build stages install into a virtual environment.
FROM ${BASE} AS build
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_CONFIG_FILE=/run/secrets/pip.conf \
    NPM_CONFIG_USERCONFIG=/run/secrets/npmrc PYTHONDONTWRITEBYTECODE=1
WORKDIR /source
RUN python -m venv /build
ENV PATH=/build/bin:$PATH


# The page is built with Node from a Python wheel, so that no second base image is needed.
FROM build AS page
COPY requirements/node.lock requirements/
RUN --mount=type=secret,id=pip.conf --mount=type=secret,id=certificates \
    pip install --quiet --require-hashes -r requirements/node.lock
COPY webui/handover_web/__init__.py webui/handover_web/build.py webui/handover_web/
COPY webui/app webui/app
RUN --mount=type=secret,id=npmrc --mount=type=secret,id=certificates \
    PYTHONPATH=webui python -m handover_web.build


# What the distribution needs of others, with hashes. The next stage is built again only if this file changes.
FROM build AS requirements
ARG DISTRIBUTION
COPY . .
RUN python -m requirements.subset "$DISTRIBUTION" >/requirements.txt


# The packages of others, then the wheels of ours.
FROM build AS install
ARG DISTRIBUTION
RUN python -m venv /opt/handover
COPY requirements/tools.lock requirements/
COPY --from=requirements /requirements.txt requirements/
RUN --mount=type=secret,id=pip.conf --mount=type=secret,id=certificates \
    /opt/handover/bin/pip install --quiet --require-hashes --only-binary :all: -r requirements/requirements.txt \
    && pip install --quiet --require-hashes --only-binary :all: -r requirements/tools.lock
COPY . .
COPY --from=page /source/webui/handover_web/page webui/handover_web/page
RUN for folder in $(python -m requirements.subset --folders "$DISTRIBUTION"); do \
        (cd "$folder" && hatchling build -t wheel -d /wheels) || exit 1; \
    done \
    && /opt/handover/bin/pip install --quiet --no-deps --no-index /wheels/*.whl \
    && /opt/handover/bin/python -m compileall -q /opt/handover/lib \
    && /opt/handover/bin/pip uninstall --quiet --yes pip


FROM ${BASE}
LABEL org.opencontainers.image.title="Handover" \
      org.opencontainers.image.description="People and robots hand work to each other"
# Motion planning and solvers need OpenMP, which slim images lack.
ARG DISTRIBUTION
RUN case "$DISTRIBUTION" in handover-robots* | handover-humanoid* | *motion* | *physics* | *humanoid* | *all*) \
        apt-get update && apt-get install --yes --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*;; \
    esac
RUN useradd --uid 10001 --user-group --no-create-home --home-dir /data --shell /usr/sbin/nologin handover \
    && install -d -o handover -g handover -m 0700 /data /secrets /authority /security /secrets-of \
        /secrets-of/gloves /secrets-of/databases /secrets-of/recordings \
    && install -d -o handover -g handover -m 0755 /tls /tls/clients /tls/context-broker /tls/task-orchestrator \
        /tls/gesture-controller /tls/trajectory-tool /tls/study /tls/alert-router /tls/accounts /tls/device-gateway /tls/webui /tls/human-state /tls/assistive-devices \
        /tls/whole-body-control /tls/ros-bridge /tls/other-broker /tls/postgres /tls/operator
COPY --from=install /opt/handover /opt/handover
ENV PATH=/opt/handover/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONSAFEPATH=1 \
    HANDOVER_HOST=0.0.0.0 \
    HANDOVER_DATA_DIR=/data \
    HANDOVER_LOG_FORMAT=json
WORKDIR /data
USER 10001:10001
ENTRYPOINT []
CMD ["handover", "--help"]
