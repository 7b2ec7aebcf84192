# zerodrift's two commands in a container:
#   docker build -t zerodrift . && docker run --rm zerodrift
#   docker run --rm -v "$PWD:/sensor" zerodrift .venv/bin/zerodrift firmware -C /sensor
FROM python:3.12-slim
WORKDIR /zerodrift
COPY . .
RUN .ci/apt-install make gcc libc6-dev
RUN make setup
CMD ["make", "firmware-model"]
