#!/usr/bin/env bash
# Installs what is missing: Debian packages, and .venv on Debian's own Python. Takes 0.04 s when all is there.
# tools/setup.sh full: also what the slow tests need.
set -euo pipefail
cd "$(dirname "$0")/.."

# Another python3 on PATH (pyenv, conda) would have no dolfinx.
python=/usr/bin/python3
# libopenblas0-pthread: the reference BLAS is six times slower. gcc, libc6-dev: FFCx compiles the forms at run time.
packages=(
    python3-dolfinx python3-slepc4py python3-gmsh python3-h5py python3-scipy python3-numba libopenblas0-pthread
    openmpi-bin python3-matplotlib python3-meshio python3-rich python3-pytest python3-hypothesis
    python3-venv ca-certificates gcc libc6-dev
)
if [ "${1:-}" = full ]; then
    packages+=(paraview python3-paraview xvfb xauth) # opens the results, with no display
    # A second time-stepping code; Debian 13 has none, and its tests are skipped there.
    ! grep -q '^VERSION_CODENAME=bookworm$' /etc/os-release || packages+=(python3-siconos)
fi

fail() {
    printf 'setup: %s\n' "$@" >&2
    exit 1
}

missing_packages() {
    local package
    for package in "${packages[@]}"; do
        grep -qx "$package installed" <<<"$installed" || echo "$package"
    done
}

install_packages() {
    local as_root=()
    local by_hand="apt-get update && apt-get install --no-install-recommends $*"
    command -v apt-get >/dev/null || fail "no apt-get here. Use Debian 12 or 13 (a container will do)."
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || fail "these Debian packages are missing: $*" \
            "you are not root and there is no sudo. Ask an administrator to run" "    $by_hand" "and run again."
        as_root=(sudo)
    fi
    echo "setup: installing $* (a few minutes, log in build/setup.log)"
    mkdir -p build
    if ! { "${as_root[@]}" apt-get update -q &&
        "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends \
            -o DPkg::Lock::Timeout=300 "$@"; } >build/setup.log </dev/null; then
        tail -n 20 build/setup.log >&2
        fail "could not install these Debian packages: $*" "as root, run" "    $by_hand" "and run again."
    fi
}

make_venv() {
    echo "setup: .venv"
    rm -f .venv/ready
    "$python" -m venv --system-site-packages .venv
    # A dependency that would pull its own numpy or h5py from PyPI must fail here, not crash dolfinx later.
    "$python" - >.venv/constraints.txt <<'PYTHON'
from importlib.metadata import distributions

ours = {"numpy", "scipy", "mpi4py", "petsc4py", "slepc4py"}
print("h5py<0")  # Debian's goes by another name, so pip would not see it
print(*sorted({f"{d.name}=={d.version}" for d in distributions() if d.name in ours}), sep="\n")
PYTHON
    .venv/bin/python -m pip install --quiet --disable-pip-version-check --constraint .venv/constraints.txt \
        --editable . </dev/null ||
        fail "pip could not install the dependencies in pyproject.toml: see above (network, proxy, certificates?)."
    .venv/bin/python -c 'import dolfinx, slepc4py, gmsh, h5py, numba, pydantic' ||
        fail "the installed packages do not import: see above. To start afresh: rm -rf .venv"
}

installed=$(dpkg-query -W -f '${Package} ${db:Status-Status}\n' "${packages[@]}" 2>/dev/null || true)
mapfile -t missing < <(missing_packages)
if [ "${#missing[@]}" -gt 0 ]; then
    install_packages "${missing[@]}"
fi

# A new Debian or Python, a moved checkout or other dependencies: the environment is made again.
state=$(echo "$PWD" && "$python" --version && sha256sum /etc/os-release pyproject.toml tools/setup.sh)
if [ "$(cat .venv/ready 2>/dev/null)" != "$state" ]; then
    make_venv
    echo "$state" >.venv/ready
fi
