/* The only file that knows the scene file's keys: it reads a scene and turns the lab's
 * numbers into SI (docs/estimator.md, "From the lab's numbers to SI"). */
#ifndef PENUMBRA_SCENE_JSON_H
#define PENUMBRA_SCENE_JSON_H

#include <stdbool.h>
#include <stddef.h>

#include "core/scene.h"

/* Reads and checks a scene; what is refused stands in scenes/scene.schema.json. On success the
 * caller owes a scene_free(scene) and, where dump is not NULL, a free(*dump): the scene in SI as
 * JSON text, in double precision. On failure nothing is owed, and message (cut at message_size)
 * reads "file:line: key: reason". */
bool scene_read(const char *file, Scene *scene, char **dump, char *message, size_t message_size);

#endif
