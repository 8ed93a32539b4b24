# Penumbra's front door and the map of the experiment: every result is a file with a rule.
# `make help` prints the targets; `make -n report` shows what a page is made of.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules

VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)

## help : list the targets
.PHONY: help
help:
	@sed -n 's/^## //p' $(MAKEFILE_LIST)

# ---------------------------------------------------------------- C renderer

C_SOURCES := $(wildcard c_renderer/src/*.c)
C_HEADERS := $(wildcard c_renderer/src/*.h)
C_NAMES   := $(patsubst c_renderer/src/%.c,%,$(C_SOURCES))

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

# One build in folder $(1) by compiler $(2) with flags $(3): bin/penumbra-render, and
# lib/libpenumbra.so of the same objects but main.
define c_build
$(1)/obj/%.o: c_renderer/src/%.c Makefile pyproject.toml
	@mkdir -p $$(@D)
	$(2) $$(C_FLAGS) $(3) $$(LIB_CFLAGS) -MMD -MP -c $$< -o $$@

$(1)/bin/penumbra-render: $(C_NAMES:%=$(1)/obj/%.o)
	@mkdir -p $$(@D)
	$(2) $$(C_FLAGS) $(3) $$^ $$(LIB_LDFLAGS) -o $$@

$(1)/lib/libpenumbra.so: $(patsubst %,$(1)/obj/%.o,$(filter-out main,$(C_NAMES)))
	@mkdir -p $$(@D)
	$(2) $$(C_FLAGS) $(3) -shared $$^ $$(LIB_LDFLAGS) -o $$@

-include $(C_NAMES:%=$(1)/obj/%.d)
endef

comma := ,
CC := $(if $(filter default,$(origin CC)),gcc,$(CC))
$(eval $(call c_build,build,$(CC),-O3 -march=native -flto=auto))
$(eval $(call c_build,build/asan,gcc,-O1 -g -fno-omit-frame-pointer -fsanitize=address$(comma)undefined -fno-sanitize-recover=all))
$(eval $(call c_build,build/tsan,clang,-O1 -g -fsanitize=thread))
# No -march=native: valgrind does not know AVX-512.
$(eval $(call c_build,build/valgrind,gcc,-O1 -g))

## build : the renderer, build/bin/penumbra-render, and build/lib/libpenumbra.so
.PHONY: build
build: build/bin/penumbra-render build/lib/libpenumbra.so

## clean : remove everything that was built, rendered or measured (build/)
.PHONY: clean
clean:
	rm -rf build
