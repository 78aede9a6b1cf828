# BLAS threads: the matrices are small, so at most four. The tests use one, as rounding depends on their number;
# under mpirun they divide the cores among the ranks.
THREADS ?= $(shell n=$$(nproc); echo $$((n < 4 ? n : 4)))
test test-all: THREADS = 1
export OPENBLAS_NUM_THREADS = $(THREADS)
export OMP_NUM_THREADS = $(THREADS)

.PHONY: help setup setup-full demo test test-all test-trixie clean

help:
	@echo 'make setup        install what is missing'
	@echo 'make demo         install what is missing, solve the blade root, name the files written'
	@echo 'make test         install what is missing, run the tests'
	@echo 'make test-all     the slow tests as well, and what they need (ParaView: 1 GB on disk; pyHarm)'
	@echo 'make test-trixie  make test on Debian 13, in a chroot (as root)'
	@echo 'make clean        remove .venv and build/'

setup:
	@tools/setup.sh

setup-full:
	@tools/setup.sh full
	-@cd benchmarks && ../.venv/bin/python -c 'import peers; peers.build_environment()'

demo: setup
	.venv/bin/python demos/blade_root.py

test: setup
	.venv/bin/python -m pytest

test-all: setup-full
	.venv/bin/python -m pytest -m 'slow or not slow'

test-trixie:
	tools/trixie.sh make test

clean:
	rm -rf .venv build *.egg-info
