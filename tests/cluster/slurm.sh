#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A Slurm cluster of this one machine with two pretended GPUs: sets it up from Debian's packages, sends the smallest studio's GEN3C-shaped
# segments through profiles/slurm, checks what every job was given, and takes it down again. Scheduling is real, the GPUs are not, and a
# stand-in (gen3c_stand_in.py) writes the films. Exit status 77 and a sentence where that cannot be done; about ten minutes.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)

skip() {
  echo "tests/cluster/slurm.sh: skipped: $1" >&2
  exit 77
}

((EUID == 0)) || skip "only root can start Slurm's daemons"
for program in slurmctld slurmd munged setpriv; do
  command -v $program > /dev/null || skip "$program is not installed (apt-get install slurm-wlm munge)"
done
# The executor drops SLURM_* variables, so that the files must lie where the packages look; a cluster that is there is left alone.
[[ ! -e /etc/slurm/slurm.conf ]] || skip "/etc/slurm/slurm.conf is there already: this machine belongs to a cluster"
! { pgrep -x slurmctld || pgrep -x slurmd || pgrep -x munged; } > /dev/null || skip "Slurm or munge is running already"

work=$(mktemp -d -p "${STUDIORECON_SCRATCH:-/tmp}")
pids=()
cleanup() {
  for pid in "${pids[@]}"; do kill "$pid" 2> /dev/null || true; done
  for pid in "${pids[@]}"; do wait "$pid" 2> /dev/null || true; done
  rm -f /etc/slurm/slurm.conf /etc/slurm/gres.conf /etc/slurm/cgroup.conf
  rm -rf "$work"
}
trap cleanup EXIT

# The executor is an add-on of Snakemake: taken where it is installed, else put into an environment of this run's own beside the driver.
python=$(command -v python)
if ! "$python" -c "import snakemake_executor_plugin_slurm" 2> /dev/null; then
  "$python" -m venv --without-pip "$work/env"
  site=$("$work/env/bin/python" -c "import site; print(site.getsitepackages()[0])")
  "$python" -c "import site; print(site.getsitepackages()[0])" > "$site/driver.pth"
  pip install --quiet --no-deps --target "$site" snakemake-executor-plugin-slurm snakemake-executor-plugin-slurm-jobstep pandas python-dateutil \
    pytz six tzdata throttler > "$work/said" 2>&1 || skip "snakemake-executor-plugin-slurm cannot be installed ($(tail -n 1 "$work/said"))"
  python=$work/env/bin/python
fi

echo "== Slurm"
host=$(hostname -s)
mkdir -p /run/munge "$work/state" "$work/spool"
chown munge: /run/munge
cat > /etc/slurm/slurm.conf << END
ClusterName=one
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
SlurmctldPort=16817
SlurmdPort=16818
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MinJobAge=3600
ReturnToService=2
GresTypes=gpu
# More than this machine has: the profile's requests are met as they stand, and what runs needs little.
SlurmdParameters=config_overrides
NodeName=$host NodeAddr=127.0.0.1 CPUs=16 RealMemory=600000 Gres=gpu:2 State=UNKNOWN
PartitionName=main Nodes=$host Default=YES State=UP
END
printf 'Name=gpu File=/dev/null\nName=gpu File=/dev/zero\n' > /etc/slurm/gres.conf
echo 'CgroupPlugin=cgroup/v1' > /etc/slurm/cgroup.conf
setpriv --reuid=munge --regid=munge --clear-groups munged --foreground > "$work/munged.log" 2>&1 &
pids+=($!)
slurmctld -D > "$work/slurmctld.log" 2>&1 &
pids+=($!)
slurmd -D > "$work/slurmd.log" 2>&1 &
pids+=($!)
for _ in $(seq 60); do
  [[ $(sinfo --noheader --format %T 2> /dev/null) == idle ]] && break
  sleep 1
done
[[ $(sinfo --noheader --format %T 2> /dev/null) == idle ]] || skip "the node does not become idle ($(tail -n 1 "$work/slurmd.log"))"

echo "== requests, on this machine"
house=$work/house
mkdir "$house"
cp -r "$root"/{Snakefile,workflow,envs,config,profiles,resources} "$house"
cd "$house"
export PYTHONPATH=$house/workflow
cat > quick.yaml << 'END'
views: {synthesizer: gen3c, views_per_segment: 120}
depth: {primitives: 0}
END
films=() requests=()
for segment in 00 01 02 03; do
  films+=("results/tiny/views/$segment.film.mkv")
  requests+=("results/tiny/views/$segment.request.npz")
done
options=(--configfile quick.yaml --config dataset=resources/studio/tiny.yaml)
"$python" -m snakemake --cores 2 "${options[@]}" -- "${requests[@]}" > "$work/requests.log" 2>&1 || { tail -n 40 "$work/requests.log"; exit 1; }

echo "== segments, through Slurm"
mkdir "$work/bin"
printf '#!/usr/bin/env bash\nif [[ " $* " == *" views.generate "* ]]; then exec %q %q "$@"; fi\nexec %q "$@"\n' \
  "$python" "$here/gen3c_stand_in.py" "$python" > "$work/bin/python"
chmod +x "$work/bin/python"
PATH=$work/bin:$PATH "$python" -m snakemake --profile profiles/slurm "${options[@]}" --slurm-status-command squeue --slurm-no-account \
  --slurm-init-seconds-before-status-checks 2 --seconds-between-status-checks 2 --default-resources slurm_partition=main -- "${films[@]}" \
  > "$work/slurm.log" 2>&1 || { tail -n 60 "$work/slurm.log"; exit 1; }

echo "== what the jobs had"
scontrol show jobs > "$work/jobs"
"$python" "$here/jobs_had.py" notes "$work/jobs" "${films[@]}"
echo "all done"
