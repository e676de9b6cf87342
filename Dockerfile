# morphofold as a BIDS-App: docker run IMAGE BIDS_DIR OUTPUT_DIR {participant,group}; other commands by --entrypoint morphofold.
# Apptainer builds the same image: apptainer build morphofold.sif docker-archive:morphofold.tar
FROM python:3.13-slim

RUN apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libgomp1 libxrender1 \
    && rm -rf /var/lib/apt/lists/*

COPY . /source
RUN pip install --no-cache-dir -c /source/constraints.txt /source && rm -rf /source

# Containers are read-only on clusters, and their users have no home: what numba compiles goes to /tmp, or where you mount a folder.
ENV NUMBA_CACHE_DIR=/tmp/morphofold-compiled \
    MPLCONFIGDIR=/tmp/morphofold-matplotlib \
    MORPHOFOLD_RENDERER=raster \
    PYTHONUNBUFFERED=1

ENTRYPOINT ["morphofold", "bids"]
