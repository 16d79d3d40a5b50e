# One image for learner, actors and evaluators. All need JAX, MuJoCo and Zenoh, which are nearly all of its size: an image each
# would be names for the same layers. TensorBoard's adds a thin layer to it.
ARG BASE_IMAGE=python:3.11-slim-bookworm

FROM ${BASE_IMAGE} AS build
# run: for a CPU. cuda: with JAX's CUDA plugin as well.
ARG REQUIREMENTS=run
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /build
# Two environments: pip and what builds our wheel stay behind in this stage.
RUN python3 -m venv tools && python3 -m venv --without-pip /opt/venv
COPY requirements requirements
RUN tools/bin/pip --python /opt/venv/bin/python install --require-hashes -r requirements/${REQUIREMENTS}.txt
RUN tools/bin/pip install --require-hashes -r requirements/build.txt
COPY pyproject.toml setup.py README.md ./
COPY common common
COPY services services
COPY reskpn reskpn
# Beside the environment, not in it: a change of the code leaves the large layer as it is.
RUN tools/bin/pip wheel --no-deps --no-build-isolation --wheel-dir wheels . \
    && tools/bin/pip --python /opt/venv/bin/python install --no-deps --no-index --target /opt/reskpn wheels/*.whl

FROM ${BASE_IMAGE} AS service
RUN useradd --uid 10001 --user-group --no-create-home --home-dir /data reskpn \
    && install -d -o reskpn -g reskpn /data /data/runs /cache
COPY --from=build /opt/venv /opt/venv
COPY --from=build /opt/reskpn /opt/reskpn
ENV PATH=/opt/reskpn/bin:/opt/venv/bin:$PATH \
    PYTHONPATH=/opt/reskpn \
    PYTHONUNBUFFERED=1 \
    RESKPN_CACHE_DIR=/cache
USER reskpn
WORKDIR /data
ENTRYPOINT ["reskpn"]
CMD ["--help"]

FROM build AS build-tensorboard
# Into a folder of its own, and only what is not in the environment already: the other layers are shared.
RUN tools/bin/pip --python /opt/venv/bin/python install --require-hashes --prefix /opt/tensorboard \
    -r requirements/tensorboard.txt

FROM service AS tensorboard
COPY --from=build-tensorboard /opt/tensorboard /opt/tensorboard
ENV PYTHONPATH=/opt/tensorboard/lib/python3.11/site-packages
EXPOSE 6006
ENTRYPOINT ["python", "-m", "tensorboard.main"]
CMD ["--logdir", "/data/runs", "--host", "0.0.0.0", "--port", "6006", "--reload_interval", "10"]

# What a build without a target gives.
FROM service
