# Penumbra's front door and the map of the experiment: every result is a file with a rule.
# `make help` prints the targets; `make -n report` shows what a page is made of.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SECONDEXPANSION:
.SUFFIXES:
# One step at a time, even under -j: each uses every core, and some measure time.
.NOTPARALLEL:
MAKEFLAGS += --no-builtin-rules

## help : list the targets
.PHONY: help
help:
	@sed -n 's/^## //p' $(MAKEFILE_LIST)

# ---------------------------------------------------------------- set-up

# Installs what is missing; not asked again until what it installs changes. See setup.sh.
build/setup.run: setup.sh requirements.txt pyproject.toml
	./setup.sh run
	@touch $@

build/setup.test: build/setup.run
	./setup.sh test
	@touch $@

## lock : pin requirements.in anew in requirements.txt, at the newest versions
.PHONY: lock
lock: | build/setup.run
	.venv/bin/python -m venv build/lock
	build/lock/bin/pip install --quiet --disable-pip-version-check uv
	build/lock/bin/uv pip compile requirements.in --output-file requirements.txt --upgrade \
	    --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --quiet

# ---------------------------------------------------------------- C renderer

VERSION := $(shell sed -n 's/^version = "\([^"]*\)".*/\1/p' pyproject.toml)
C_NAMES := $(patsubst c_renderer/src/%.c,%,$(wildcard c_renderer/src/*.c))

# OpenEXR's headers warn under -Wpedantic: -isystem. Asked of pkg-config when a recipe runs, not
# when this file is read, since set-up may just have installed it.
LIB_CFLAGS  = $(shell pkg-config --cflags jansson) \
              $(patsubst -I%,-isystem %,$(shell pkg-config --cflags-only-I OpenEXR))
# Of OpenEXR's libraries only the C one, whatever version its name carries.
LIB_LDFLAGS = $(shell pkg-config --libs jansson) \
              $(filter -L% -lOpenEXRCore%,$(shell pkg-config --libs OpenEXR)) -lm

# -fno-math-errno: without it gcc keeps every square root scalar.
C_FLAGS := -std=c99 -Wall -Wextra -Wpedantic -Wconversion -fPIC -fopenmp -fno-math-errno \
           -DPENUMBRA_VERSION='"$(VERSION)"'

# One build, in folder $(1), once set up for $(2), by compiler $(3) with flags $(4):
# bin/penumbra-render, and lib/libpenumbra.so of the same objects but main.
define c_build
$(1)/obj/%.o: c_renderer/src/%.c Makefile pyproject.toml | build/setup.$(2)
	@mkdir -p $$(@D)
	$(3) $$(C_FLAGS) $(4) $$(LIB_CFLAGS) -MMD -MP -c $$< -o $$@

$(1)/bin/penumbra-render: $(C_NAMES:%=$(1)/obj/%.o)
	@mkdir -p $$(@D)
	$(3) $$(C_FLAGS) $(4) $$^ $$(LIB_LDFLAGS) -o $$@

$(1)/lib/libpenumbra.so: $(patsubst %,$(1)/obj/%.o,$(filter-out main,$(C_NAMES)))
	@mkdir -p $$(@D)
	$(3) $$(C_FLAGS) $(4) -shared $$^ $$(LIB_LDFLAGS) -o $$@

-include $(C_NAMES:%=$(1)/obj/%.d)
endef

CHECKED := -O1 -g -fno-omit-frame-pointer -fno-sanitize-recover=all
$(eval $(call c_build,build,run,gcc,-O3 -march=native -flto=auto))
$(eval $(call c_build,build/asan,test,gcc,$(CHECKED) -fsanitize=address -fsanitize=undefined))
$(eval $(call c_build,build/tsan,test,clang,$(CHECKED) -fsanitize=thread))
# For any x86-64: valgrind does not know the newest processors' instructions.
$(eval $(call c_build,build/valgrind,test,gcc,$(CHECKED)))

## build : the renderer, build/bin/penumbra-render, and build/lib/libpenumbra.so
.PHONY: build
build: build/bin/penumbra-render build/lib/libpenumbra.so

## clean : remove everything that was built, rendered or measured (build/)
.PHONY: clean
clean:
	rm -rf build
