# Debian 12 with everything the platform needs, a user without root, and a built workspace:
#
#   docker build -t surg . && docker run --rm -it surg ./surg demo
#
# The stage `tools` holds the packages alone; .devcontainer uses it with your checkout mounted.
# These files have not been tried with a container engine yet.
FROM debian:12 AS tools

ENV LANG=C.UTF-8
COPY tools/apt-packages.txt /tmp/
RUN apt-get update \
    && sed 's/#.*//' /tmp/apt-packages.txt \
       | DEBIAN_FRONTEND=noninteractive xargs apt-get install -y --no-install-recommends \
           ca-certificates git sudo \
    && rm -rf /var/lib/apt/lists/* /tmp/apt-packages.txt
RUN useradd --create-home --shell /bin/bash --uid 1000 surg \
    && echo 'surg ALL=(ALL) NOPASSWD: ALL' > /etc/sudoers.d/surg
USER surg

FROM tools AS built
COPY --chown=surg:surg . /home/surg/surg
WORKDIR /home/surg/surg
RUN ./surg dev build
CMD ["./surg", "dev", "shell"]
