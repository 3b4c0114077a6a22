# egotac in a container: docker build -t egotac . && docker run --rm egotac doctor
#
# A page of `egotac view` inside must listen on all addresses to be seen outside:
#   docker run --rm -p 127.0.0.1:7007:7007 -v "$PWD:/data" egotac view /data/video.mp4 --listen 0.0.0.0:7007
FROM debian:bookworm AS build
RUN apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
    ca-certificates curl g++ git libc6-dev make python3 python3-dev python3-venv ffmpeg libegl1 libegl-mesa0 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
RUN curl --proto '=https' -sSf https://sh.rustup.rs | sh -s -- -y --profile minimal --default-toolchain 1.95.0
ENV PATH=/root/.cargo/bin:$PATH
COPY . /src
WORKDIR /src
RUN scripts/dist --out /dist && mkdir /egotac && tar -xzf /dist/*.tar.gz -C /egotac --strip-components=1

FROM debian:bookworm-slim
RUN apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
    ca-certificates curl ffmpeg libegl1 libegl-mesa0 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /egotac /opt/egotac
WORKDIR /data
EXPOSE 7007
ENTRYPOINT ["bash", "-c", ". /opt/egotac/env.sh && exec egotac \"$@\"", "egotac"]
CMD ["--help"]
