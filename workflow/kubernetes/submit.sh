#!/usr/bin/env bash
# Begins a job of Snakemake as a job of Kubernetes, and prints its name: submit.sh THREADS MEMORY_MB JOBSCRIPT
# A pod that is lost is begun again.
set -euo pipefail
threads=$1 memory=$2 script=$(realpath "${@: -1}")
name=udc-$(od -An -N6 -tx1 /dev/urandom | tr -d ' \n')
kubectl create -f - >&2 <<JOB
apiVersion: batch/v1
kind: Job
metadata: {name: $name, labels: {app: udc}}
spec:
  backoffLimit: 3
  ttlSecondsAfterFinished: 86400
  template:
    spec:
      restartPolicy: Never
      containers:
        - name: udc
          image: ${UDC_IMAGE:?the image of workflow/Containerfile}
          workingDir: $PWD
          command: ["sh", "$script"]
          env: [{name: UDC_SIMD, value: "${UDC_SIMD:-}"}]
          resources:
            requests: {cpu: "$threads", memory: ${memory}M}
            limits: {memory: ${memory}M}
          volumeMounts: [{name: study, mountPath: ${UDC_MOUNT:-/study}}]
      volumes:
        - {name: study, persistentVolumeClaim: {claimName: ${UDC_CLAIM:-udc-study}}}
JOB
echo "$name"
