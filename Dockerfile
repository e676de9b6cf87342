# morphofold as a BIDS-App: docker run IMAGE BIDS_DIR OUTPUT_DIR {participant,group}; other commands by
# docker run --entrypoint container.sh IMAGE morphofold analyze SUBJECT.
# Apptainer builds the same image: apptainer build morphofold.sif docker-archive:morphofold.tar
FROM python:3.13-slim

RUN apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libgomp1 libxrender1 \
    && rm -rf /var/lib/apt/lists/*

COPY . /source
RUN pip install --no-cache-dir -c /source/constraints.txt "/source[group]" && rm -rf /source

ENV PYTHONUNBUFFERED=1

# Compiles all kernels once, by growing and measuring a cortex.
COPY container.sh /usr/local/bin/
RUN mkdir /opt/morphofold \
    && container.sh sh -c 'morphofold demo -q -o /tmp/demo && cp -r "$NUMBA_CACHE_DIR/../." /opt/morphofold && rm -rf /tmp/demo'

ENTRYPOINT ["container.sh", "morphofold", "bids"]
