#define _POSIX_C_SOURCE 200809L

#include "output.h"

#include <errno.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { BUFFER_SIZE = 1 << 20 };
enum { MOST_LINKS = 40 }; /* as many as Linux itself follows */

static char *concatenate(const char *first, size_t length, const char *second)
{
    char *both = malloc(length + strlen(second) + 1);
    if (both)
        strcpy((char *)memcpy(both, first, length) + length, second);
    return both;
}

/* The file at the end of a chain of links, which need not exist. NULL with errno. */
static char *follow(const char *name)
{
    char *path = concatenate(name, strlen(name), "");
    for (int links = 0; path; links++) {
        char link[PATH_MAX];
        ssize_t length = readlink(path, link, sizeof link - 1);
        if (length < 0) /* no link, or not there: opening it will tell */
            return path;
        if (links == MOST_LINKS) {
            free(path);
            errno = ELOOP;
            return NULL;
        }
        link[length] = '\0';
        const char *slash = strrchr(path, '/');
        size_t folder = link[0] == '/' || !slash ? 0 : (size_t)(slash - path) + 1;
        char *next = concatenate(path, folder, link);
        free(path);
        path = next;
    }
    return NULL;
}

/* The standard output or error that a file is; -1: neither. Terminals and other devices are opened
 * by name. */
static int standard_stream(const struct stat *file)
{
    for (int descriptor = STDOUT_FILENO; descriptor <= STDERR_FILENO; descriptor++) {
        struct stat open;
        if (fstat(descriptor, &open) == 0 && !S_ISCHR(open.st_mode) &&
            open.st_dev == file->st_dev && open.st_ino == file->st_ino)
            return descriptor;
    }
    return -1;
}

bool output_find(const char *name, Output *output)
{
    *output = (Output){.name = name, .descriptor = -1};
    struct stat file;
    if (stat(name, &file) == 0) {
        if (S_ISDIR(file.st_mode)) {
            errno = EISDIR;
            return false;
        }
        output->descriptor = standard_stream(&file);
        if (!S_ISREG(file.st_mode) || output->descriptor >= 0)
            return true;
    }
    output->target = follow(name);
    if (output->target)
        output->part = concatenate(output->target, strlen(output->target), ".part");
    return output->part;
}

bool output_begin(Output *output)
{
    output->stream = output->target ? fopen(output->part, "wb") : tmpfile();
    output->buffer = malloc(BUFFER_SIZE);
    if (output->stream && output->buffer)
        setvbuf(output->stream, output->buffer, _IOFBF, BUFFER_SIZE);
    return output->stream;
}

/* Copies the temporary file to the device or pipe. */
static bool write_through(const Output *output)
{
    char buffer[1 << 16];
    size_t read;
    fflush(stdout); /* what was printed before comes before */
    rewind(output->stream);
    FILE *stream =
        output->descriptor < 0 ? fopen(output->name, "wb") : fdopen(dup(output->descriptor), "wb");
    bool written = stream;
    while (written && (read = fread(buffer, 1, sizeof buffer, output->stream)) > 0)
        written = fwrite(buffer, 1, read, stream) == read;
    written = written && !ferror(output->stream);
    return stream && fclose(stream) == 0 && written;
}

bool output_end(Output *output, bool keep)
{
    bool written = fflush(output->stream) == 0;
    if (!output->target && keep && written)
        written = write_through(output);
    written = fclose(output->stream) == 0 && written;
    output->stream = NULL;
    if (!output->target)
        return written;
    if (written && keep && rename(output->part, output->target) == 0)
        return true;
    int reason = errno;
    remove(output->part);
    errno = reason;
    return written && !keep;
}

void output_free(Output *output)
{
    free(output->target);
    free(output->part);
    free(output->buffer);
}
