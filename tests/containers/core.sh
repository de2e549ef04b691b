#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Builds the core image for real with podman (as snakemake images does) and runs rules under --sdm apptainer with only what it has, by the
# stand-in beside this file. Exit status 77 and a sentence where that cannot be done. About ten minutes and 5 GB, in a folder of its own.
#
#   tests/containers/core.sh [TARGET …]      (default: the smallest studio's calibration and one camera's frames)
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
targets=("$@")
((${#targets[@]})) || targets=(results/tiny/calibration/calibration.json results/tiny/capture/cam1.mkv)

skip() {
  echo "tests/containers/core.sh: skipped: $1" >&2
  exit 77
}

command -v podman > /dev/null || skip "podman is not installed"
work=$(mktemp -d -p "${STUDIORECON_SCRATCH:-/tmp}")
cleanup() {
  podman rmi --all --force > /dev/null 2>&1 || true
  rm -rf "$work" 2> /dev/null || podman unshare rm -rf "$work"
}
trap cleanup EXIT

# A store of its own. Raising limits and cgroups are refused to podman on many virtual machines; these settings ask for neither.
driver=$(podman --root "$work/store" info --format '{{.Store.GraphDriverName}}' 2> "$work/said") || skip "podman does not work here ($(tail -n 1 "$work/said"))"
printf '[storage]\ndriver = "%s"\ngraphroot = "%s"\nrunroot = "%s"\n' "$driver" "$work/store" "$work/run" > "$work/storage.conf"
runtime=$(command -v runc > /dev/null && echo runc || echo crun)
cat > "$work/containers.conf" << END
[containers]
netns = "host"
default_ulimits = ["nofile=1024:1024", "nproc=1000:1000"]
[engine]
cgroup_manager = "cgroupfs"
runtime = "$runtime"
END
export CONTAINERS_CONF=$work/containers.conf CONTAINERS_STORAGE_CONF=$work/storage.conf

base=$(sed -n 's/^ARG BASE=//p' "$root/envs/core/Containerfile")
if ! podman pull --quiet "$base" > "$work/said" 2>&1; then
  # No registry: a Debian with Python takes the base's place, and wheels lie inside it.
  ((EUID == 0)) && command -v debootstrap > /dev/null || skip "no registry has $base ($(tail -n 1 "$work/said")), and debootstrap as root is not there"
  echo "== $base cannot be pulled; a Debian of the same Python stands in for it"
  debootstrap --variant=minbase --include=python3-minimal,python3-pip,python-is-python3,ca-certificates bookworm "$work/rootfs" > "$work/said" 2>&1 \
    || skip "debootstrap failed ($(tail -n 1 "$work/said"))"
  pip download --quiet -d "$work/rootfs/opt/wheels" -r "$root/envs/core/requirements.txt" --python-version 3.11 --only-binary=:all: \
    > "$work/said" 2>&1 || skip "the wheels cannot be fetched ($(tail -n 1 "$work/said"))"
  printf '[global]\nno-index = true\nfind-links = /opt/wheels\nbreak-system-packages = true\n' > "$work/rootfs/etc/pip.conf"
  tar -C "$work/rootfs" -c . | podman import --quiet - "$base" > /dev/null
  rm -rf "$work/rootfs"
fi

echo "== the core image"
version=$(sed -n 's/^core:.*version: "\([^"]*\)".*/\1/p' "$root/envs/images.yaml")
export PYTHONPATH=$root/workflow
python -m studiorecon models.containers --images "core=studiorecon/core:$version" --root "$root" --folder "$work/images"

echo "== rules in it"
# In a copy: a container sees the folder it is started in, and the workflow has to lie there.
mkdir "$work/house"
cp -r "$root"/{Snakefile,workflow,envs,config,profiles,resources} "$work/house"
cd "$work/house"
export PYTHONPATH=$work/house/workflow
PATH=$here:$PATH python -m snakemake --sdm apptainer --cores 2 --config dataset=resources/studio/tiny.yaml \
  "images=$work/images" -- "${targets[@]}" > "$work/log" 2>&1 || { tail -n 60 "$work/log"; exit 1; }
grep -c "Activating singularity image" "$work/log" | sed 's/$/ jobs ran in the image/'
for target in "${targets[@]}"; do [[ $target != */* ]] || test -s "$target"; done
# What ran was the image's own package: torch, which the driver may have and the image has not, is not there.
if podman run --rm --network=none "localhost/studiorecon/core:$version" python -c "import torch" 2> /dev/null; then
  echo "the core image has torch" && exit 1
fi
echo "all done"
