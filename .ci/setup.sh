#!/usr/bin/env bash
# Set up what kncal needs, doing only what is missing: Debian packages, the environment .venv, the package.
#
#   bash .ci/setup.sh run    to use kncal
#   bash .ci/setup.sh dev    to test and change it: adds the development extra
#
# Called by the Makefile. Needs python3 >= 3.11; installs Debian packages with sudo when not root.
set -euo pipefail
CDPATH= cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."

level=${1:-}
environment=.venv

say() { printf 'setup: %s\n' "$*"; }
warn() { printf 'setup: warning: %s\n' "$*" >&2; }
fail() {
    printf 'setup: error: %s\n' "$*" >&2
    exit 1
}

case $level in
run | dev) ;;
*) fail "expected 'run' or 'dev', not '$level'" ;;
esac

have() { command -v "$1" >/dev/null 2>&1; }

# --- Python ----------------------------------------

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }

# Debian ships ensurepip in python3-venv; without it `python3 -m venv` fails. An activated .venv is no base for itself.
can_make_environments() {
    new_enough "$1" && "$1" -c '
import ensurepip, os, sys, venv
sys.exit(os.path.realpath(sys.prefix) == os.path.realpath(".venv"))' >/dev/null 2>&1
}

first_that() { # first_that CHECK: print the first Python that passes
    local candidate
    for candidate in python3 /usr/bin/python3; do
        if "$1" "$candidate"; then
            printf '%s\n' "$candidate"
            return 0
        fi
    done
    return 1
}

environment_works() {
    new_enough "$environment/bin/python" && "$environment/bin/python" -c 'import pip' >/dev/null 2>&1
}

# --- Debian packages ----------------------------------------

install() { # install PACKAGE...: returns non-zero, having said why, if they cannot be installed
    local as_root=()
    if ! have apt-get; then
        warn "no apt-get on this machine; install what Debian calls: $*"
        return 1
    fi
    if [ "$(id -u)" -ne 0 ]; then
        if ! have sudo; then
            warn "neither root nor sudo; have an administrator run: apt-get install $*"
            return 1
        fi
        as_root=(sudo)
    fi
    local apt=(${as_root[@]+"${as_root[@]}"} env DEBIAN_FRONTEND=noninteractive
        apt-get -q -y -o DPkg::Lock::Timeout=300)
    if [ -z "${lists_are_fresh:-}" ]; then
        say "apt-get update"
        "${apt[@]}" update >/dev/null </dev/null || warn "apt-get update failed; trying with the lists at hand"
        lists_are_fresh=yes
    fi
    say "apt-get install $* (may take some minutes)"
    "${apt[@]}" install --no-install-recommends "$@" >/dev/null </dev/null || {
        warn "apt-get install failed: $*"
        return 1
    }
}

missing_libraries() { # off-screen pictures need EGL and Mesa's software renderer; only dpkg knows all three names
    local package
    if have dpkg-query; then
        for package in libegl1 libegl-mesa0 libgl1-mesa-dri; do
            dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null | grep -q '^installed' || echo "$package"
        done
    fi
}

needed=()
wanted=()
have liggghts || needed+=(liggghts)
if ! environment_works && ! first_that can_make_environments >/dev/null; then
    first_that new_enough >/dev/null ||
        fail "kncal needs Python 3.11 or newer; python3 is $(python3 --version 2>&1 || echo 'not installed')"
    needed+=(python3-venv)
fi
have DPMFoam || wanted+=(openfoam)
testing=() # for the tests of sweeps that start a Slurm of their own, which only root can; they are skipped without it
if [ "$level" = dev ] && [ "$(id -u)" -eq 0 ]; then
    [ -x /usr/sbin/slurmctld ] || testing+=(slurmctld)
    [ -x /usr/sbin/slurmd ] || testing+=(slurmd)
    [ -x /usr/sbin/munged ] || testing+=(munge)
    have sbatch || testing+=(slurm-client)
fi
while IFS= read -r package; do wanted+=("$package"); done < <(missing_libraries)

# Several calls: what only some cases or pictures need must not keep the rest from being installed.
if [ ${#needed[@]} -gt 0 ]; then install "${needed[@]}" || true; fi
if [ ${#wanted[@]} -gt 0 ]; then
    install "${wanted[@]}" || warn "going on without: ${wanted[*]} (needed for gas or for 3-D pictures only)"
fi

if [ ${#testing[@]} -gt 0 ]; then
    install "${testing[@]}" || warn "going on without: ${testing[*]} (the tests with a real Slurm are skipped)"
fi

# --- environment and package ----------------------------------------

if ! environment_works; then
    python=$(first_that can_make_environments) ||
        fail "no Python that can make virtual environments; on Debian: apt-get install python3-venv"
    say "making the environment $environment with $python"
    "$python" -m venv --clear "$environment"
fi

# What the installed packages depend on; an editable install also holds the checkout's own path.
key=$("$environment/bin/python" -I -c '
import hashlib, os, pathlib, sys
print(hashlib.sha256(pathlib.Path("pyproject.toml").read_bytes()).hexdigest(), sys.version.split()[0], os.getcwd())')

installed() { [ -x "$environment/bin/kncal" ] && [ "$(cat "$environment/kncal-$1.stamp" 2>/dev/null)" = "$key" ]; }

if [ "$level" = run ] && ! installed run && ! installed dev; then
    say "installing kncal and its Python packages into $environment (some minutes the first time)"
    "$environment/bin/python" -m pip install --quiet --no-input --editable .
    printf '%s\n' "$key" >"$environment/kncal-run.stamp"
elif [ "$level" = dev ] && ! installed dev; then
    say "installing kncal, its Python packages and the development tools into $environment (some minutes the first time)"
    "$environment/bin/python" -m pip install --quiet --no-input --editable '.[dev]'
    printf '%s\n' "$key" >"$environment/kncal-dev.stamp"
fi

have liggghts || fail "LIGGGHTS is missing (Debian and Ubuntu: apt-get install liggghts); \
$environment is ready and runs every small scene with --engine builtin"
