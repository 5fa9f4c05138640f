# Everything sets itself up: Python >= 3.11, cargo and make are all that a machine needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUST := $(shell find rust Cargo.toml Cargo.lock pyproject.toml -type f 2>/dev/null)

.DEFAULT_GOAL := help
.PHONY: help demo test test-rest test-all nightly check wheel sdist notice licences hooks bench mutants rooms gallery docs clean

help: ## Show what can be made
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-9s %s\n", $$1, $$2}'

demo: $(VENV)/demo ## Flatten the photo of a bent page, and fit a surface to terrain; see demo-output/
	$(BIN)/python examples/demo_warp.py
	$(BIN)/python examples/demo_surface.py

test: $(VENV)/test ## Run the tests, of Rust and of Python, but for those that take long
	cargo test --release --locked --quiet
	$(BIN)/python -m pytest -m "not slow and not paper" --hypothesis-profile fast -n logical

test-rest: $(VENV)/test ## Run what `make test` leaves out: slow tests, the paper's, more random examples
	$(BIN)/python -m pytest -m "slow or paper or hypothesis" --hypothesis-profile ci

test-all: test test-rest ## Run every test

nightly: $(VENV)/test ## Try 2,000 other random examples of every property
	$(BIN)/python -m pytest -m hypothesis --hypothesis-profile nightly

check: $(VENV)/check $(VENV)/test ## Check format, lint, types, imports and the native module's stub
	cargo fmt --check
	cargo clippy --locked --all-targets --features python --quiet -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --quiet
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest mexpress._core
	$(BIN)/python -m pytest tests/unit/test_architecture.py
	$(BIN)/zizmor --offline --quiet .github
	$(BIN)/python release/notice.py --check

# maturin asks the first python3 of PATH for zig.
wheel: $(VENV)/release ## Build the wheel for Linux, and use it in empty environments
	rm -f dist/*.whl
	PATH="$(CURDIR)/$(BIN):$$PATH" maturin build --release --locked --zig --compatibility manylinux_2_17 --out dist
	$(BIN)/abi3audit --strict --summary dist/*.whl
	$(BIN)/auditwheel show dist/*.whl
	$(BIN)/twine check --strict dist/*.whl
	$(BIN)/python release/install.py dist/*.whl

# What is built of an sdist shares the crates that it depends on with other builds.
sdist: $(VENV)/release ## Pack the sources, build the package from them alone, and use it in empty environments
	rm -f dist/*.tar.gz
	$(BIN)/maturin sdist --out dist
	$(BIN)/twine check --strict dist/*.tar.gz
	CARGO_TARGET_DIR=$(CURDIR)/target $(BIN)/python release/install.py dist/*.tar.gz

notice: $(VENV)/pip ## Write the licences of the crates that a wheel holds anew: NOTICE
	$(BIN)/python release/notice.py

licences: ## Check that all crates are under licences that deny.toml allows
	cargo deny --version >/dev/null 2>&1 || cargo install cargo-deny --locked
	cargo deny --locked check licenses sources

# R's mgcv competes where it is: apt-get install r-base-core r-cran-mgcv
bench: $(VENV)/bench ## Put this machine's times, beside other libraries', into docs/benchmarks.md
	$(BIN)/python benches/page.py
	$(BIN)/python -m pytest benches/test_*.py --benchmark-group-by=group
	cargo bench --locked

mutants: ## Break the core's arithmetic line by line, and list what no Rust test notices (hours)
	cargo mutants --version >/dev/null 2>&1 || cargo install cargo-mutants --locked
	cargo mutants --no-shuffle --output target

hooks: $(VENV)/dev ## Check format, lint and types at every commit from now on
	$(BIN)/pre-commit install

rooms: $(VENV)/demo ## Draw who imports whom anew: docs/rooms.png
	$(BIN)/python docs/rooms.py

gallery: $(VENV)/demo ## Draw the figures of docs/gallery/ and the picture of README anew
	$(BIN)/python docs/gallery.py
	$(BIN)/python examples/demo_warp.py --picture docs/bent-page.jpg

# Help of commands is as wide as the terminal, and the theme tells of its successor at every build: neither is wanted.
docs: $(VENV)/docs ## Build the site, site/index.html, and the crate's documentation
	COLUMNS=80 NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	cargo doc --locked --no-deps --quiet

clean: ## Remove what was built
	rm -rf target $(VENV) demo-output dist site .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/pip:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=25.1'
	@touch $@

$(VENV)/built: $(VENV)/pip $(RUST)
	$(BIN)/python -m pip install --quiet 'maturin>=1.9.4,<2'
	$(BIN)/python -m pip install --quiet --no-build-isolation --editable .
	@touch $@

# A stamp for each group of tools, installed when first wanted.
$(VENV)/demo $(VENV)/test $(VENV)/check $(VENV)/dev $(VENV)/bench $(VENV)/docs $(VENV)/release: $(VENV)/built
	$(BIN)/python -m pip install --quiet --group $(notdir $@)
	@touch $@
