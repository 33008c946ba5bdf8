#!/usr/bin/env bash
# The miniature study by one process after the other, none of them sharded: what every division must end with.
# usage: one-process.sh UDC      in a folder with study.toml, panel.toml and network.toml; writes study/
set -euo pipefail
udc=$1
dataset=study/datasets/pentile-noisy run=study/runs/pentile-noisy/small results=study/results/pentile-noisy
mkdir -p study/panels/pentile
"$udc" psf --display panel.toml -o study/panels/pentile/psf.exr
"$udc" codes study/panels/pentile/psf.exr --angles=-3:3:3 --dim 2 -o study/panels/pentile/bank.safetensors
"$udc" scenes -o study/scenes --count 24 --seed 3 --size 64 --margin 0 --half
"$udc" synth study/scenes --bank study/panels/pentile/bank.safetensors --noise gaussian:0.01 --seed 3 \
    --test-fraction 0.34 -o "$dataset" --half
"$udc" train network.toml --data "$dataset" -o "$run"
"$udc" eval "$dataset" --metrics psnr,ssim --model "$run/model.safetensors" --method wiener -o "$results"
"$udc" report study/panels/pentile/bank.safetensors "$run" "$results" -o study/report.html
