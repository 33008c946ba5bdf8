#!/usr/bin/env bash
# A real Slurm on this machine alone: a controller and two node daemons of one core each, on the loopback interface.
# Needs `apt-get install slurm-wlm munge`, and root.
# usage: slurm.sh start DIR                 then: export SLURM_CONF=DIR/slurm.conf
#        slurm.sh kill-node DIR n1          the node's daemon and all of its jobs are killed at once
#        slurm.sh start-node DIR n1         it comes back, and its jobs are begun again
#        slurm.sh stop DIR
set -euo pipefail
what=$1 dir=$(realpath -m "$2") host=$(hostname -s)
export SLURM_CONF=$dir/slurm.conf

# The processes of a node's jobs, and the step daemons above them.
processes_of() {
    local process parent
    for process in /proc/[0-9]*; do
        if grep -qzx "SLURMD_NODENAME=$1" "$process/environ" 2>/dev/null; then
            echo "${process#/proc/}"
            parent=$(awk '/^PPid/ {print $2}' "$process/status" 2>/dev/null || true)
            [ "${parent:-1}" -gt 1 ] && echo "$parent"
        fi
    done | sort -un
}

case $what in
start)
    mkdir -p "$dir/state" /run/munge
    chown munge /run/munge
    [ -S /run/munge/munge.socket.2 ] || runuser -u munge -- /usr/sbin/munged
    cat >"$SLURM_CONF" <<CONF
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
AuthType=auth/munge
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmUser=root
SlurmdUser=root
StateSaveLocation=$dir/state
SlurmdSpoolDir=$dir/spool-%n
SlurmctldPidFile=$dir/controller.pid
SlurmdPidFile=$dir/%n.pid
SlurmctldLogFile=$dir/controller.log
SlurmdLogFile=$dir/%n.log
ReturnToService=2
SlurmdTimeout=10
JobRequeue=1
NodeName=n[1-2] NodeHostname=$host NodeAddr=127.0.0.1 Port=[17001-17002] CPUs=1 RealMemory=8000 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
    # Where programs look that drop SLURM_CONF from the environment of jobs.
    mkdir -p /etc/slurm
    [ -e /etc/slurm/slurm.conf ] && [ ! -L /etc/slurm/slurm.conf ] || ln -sfn "$SLURM_CONF" /etc/slurm/slurm.conf
    slurmctld
    slurmd -N n1
    slurmd -N n2
    for _ in $(seq 60); do
        [ "$(sinfo -h -t idle -o %D 2>/dev/null || true)" = 2 ] && break
        sleep 1
    done
    sinfo
    ;;
kill-node)
    # shellcheck disable=SC2046
    kill -9 "$(cat "$dir/$3.pid")" $(processes_of "$3") 2>/dev/null || true
    ;;
start-node) slurmd -N "$3" ;;
stop)
    for name in n1 n2 controller; do
        if [ -f "$dir/$name.pid" ]; then kill "$(cat "$dir/$name.pid")" 2>/dev/null || true; fi
    done
    ;;
*)
    echo "usage: slurm.sh start|stop|kill-node|start-node DIR [NODE]" >&2
    exit 2
    ;;
esac
