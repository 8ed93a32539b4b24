/* Where a file is written: whole under its name, or not at all. */
#ifndef PENUMBRA_OUTPUT_H
#define PENUMBRA_OUTPUT_H

#include <stdbool.h>
#include <stdio.h>

/* Links are followed, and stay: what they lead to is replaced. A device, a pipe or what standard
 * output or error is redirected to is not replaced but written to. */
typedef struct {
    const char *name; /* as the user gave it; not owned */
    char *target;     /* the plain file that it leads to; NULL: written to as it is */
    char *part;       /* with target: the unfinished file beside it */
    int descriptor;   /* without target: open already; -1: not yet */
    FILE *stream;     /* while it is written; without target a temporary file, which can seek */
    char *buffer;     /* the stream's; NULL: slower */
} Output;

/* Finds out where a name leads; creates nothing. False with errno: it cannot be written to. */
bool output_find(const char *name, Output *output);

/* Opens output->stream, which can seek. False with errno. */
bool output_begin(Output *output);

/* Closes the stream; if keep is true, the file appears. False with errno: nothing was left behind,
 * but what a device had taken in already. */
bool output_end(Output *output, bool keep);

void output_free(Output *output);

#endif
