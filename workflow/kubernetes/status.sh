#!/usr/bin/env bash
# Prints how a job of submit.sh is: success, failed or running.
set -euo pipefail
state=$(kubectl get job "$1" -o 'jsonpath={.status.conditions[?(@.status=="True")].type}')
case " $state " in
*" Complete "*) echo success ;;
*" Failed "*) echo failed ;;
*) echo running ;;
esac
