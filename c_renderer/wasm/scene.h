/* The scene that a page hands over, item by item: numbers of a scene file in, what io/scene_json
 * makes of them out, in the same bits. Limits of scenes/scene.schema.json are the page's business. */
#ifndef PENUMBRA_WASM_SCENE_H
#define PENUMBRA_WASM_SCENE_H

#include "core/scene.h"

/* A function that the page calls, by its own name. */
#define FOR_PAGE(name) __attribute__((export_name(#name))) name

/* The one of this module: a worker has its own. */
extern Scene scene;

/* Room for a picture's three floats a pixel, the module's own, until the next call. NULL: out of
 * memory. */
float *picture_room(int width, int height);

#endif
