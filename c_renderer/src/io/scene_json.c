#include "scene_json.h"

#include <errno.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "exact/vec3d.h"

/* Limits of scenes/scene.schema.json. */
#define MAX_BYTES (1 << 20)
#define MAX_ITEMS 1000
#define MAX_DESCRIPTION 1000
#define MAX_NAME 40
#define MAX_COORDINATE 1e9
#define MIN_LENGTH 1e-9
#define MAX_COLOR 1e6
#define MAX_POWER 1e30
#define MAX_RADIANCE 1e30
#define DEGREE 0.017453292519943295 /* pi / 180 */

/* One step of the way to a value: into a key, or (key == NULL) into an item of an array. */
typedef struct {
    const char *key;
    size_t index;
} Step;

/* The file being read. The first refusal sticks, and every reader below then returns zeros. */
typedef struct {
    const char *file;
    char *text; /* the whole file, NUL-terminated */
    size_t length;
    Step path[4]; /* where we are, for messages */
    int depth;
    bool refused;
    char *message;
    size_t message_size;
    char *dump;
    size_t dump_length, dump_size;
} Reader;

/* ---- where in the text a value stands ---- */

static const char *skip_space(const char *p)
{
    return p + strspn(p, " \t\r\n");
}

static const char *skip_string(const char *p)
{
    for (p++; *p != '"'; p++)
        if (*p == '\\')
            p++;
    return p + 1;
}

static const char *skip_value(const char *p)
{
    int depth = 0;
    do {
        if (*p == '"') {
            p = skip_string(p);
            continue;
        }
        if (*p == '{' || *p == '[')
            depth++;
        if (*p == '}' || *p == ']')
            depth--;
        p++;
    } while (depth > 0 || (*p && !strchr(",]} \t\r\n", *p)));
    return p;
}

/* The text is valid JSON by now. Keys are compared as they are written. */
static const char *find_step(const char *container, Step step)
{
    bool object = *container == '{';
    const char *p = skip_space(container + 1);
    for (size_t i = 0; *p != '}' && *p != ']'; i++) {
        const char *start = p;
        if (object) {
            p = skip_string(p);
            size_t length = (size_t)(p - start) - 2;
            p = skip_space(skip_space(p) + 1); /* past the colon */
            if (step.key && length == strlen(step.key) && memcmp(start + 1, step.key, length) == 0)
                return p;
        } else if (!step.key && i == step.index) {
            return p;
        }
        p = skip_space(skip_value(p));
        if (*p == ',')
            p = skip_space(p + 1);
    }
    return NULL;
}

static int line_of(const Reader *reader, const char *p)
{
    int line = 1;
    for (const char *c = reader->text; c < p; c++)
        line += *c == '\n';
    return line;
}

static int line_of_path(const Reader *reader)
{
    const char *p = skip_space(reader->text);
    for (int i = 0; i < reader->depth; i++) {
        const char *next = find_step(p, reader->path[i]);
        if (!next)
            break;
        p = next;
    }
    return line_of(reader, p);
}

/* ---- refusing ---- */

static void refuse_at_line(Reader *reader, int line, const char *key, const char *reason)
{
    if (reader->refused)
        return;
    reader->refused = true;
    char place[16] = "";
    if (line > 0)
        snprintf(place, sizeof place, "%d: ", line);
    snprintf(reader->message, reader->message_size, "%s:%s%s%s%s%s", reader->file,
             line > 0 ? "" : " ", place, key, *key ? ": " : "", reason);
}

/* What a file says, fit for one line on a terminal: no control characters (the second kind is
 * U+0080 to U+009F), and no half characters where UTF-8 text was cut. */
static void make_printable(char *text)
{
    for (unsigned char *c = (unsigned char *)text; *c;) {
        size_t wanted = *c < 0x80 ? 1 : *c < 0xC0 ? 0 : *c < 0xE0 ? 2 : *c < 0xF0 ? 3 : 4;
        size_t found = 1;
        while (found < wanted && (c[found] & 0xC0) == 0x80)
            found++;
        if (found != wanted || *c < ' ' || *c == 127 || (c[0] == 0xC2 && c[1] < 0xA0))
            memset(c, '?', found);
        c += found;
    }
}

/* Refuses what stands at the reader's path. */
static void refuse(Reader *reader, const char *format, ...)
{
    if (reader->refused)
        return;
    char key[200] = "", reason[200];
    size_t used = 0;
    for (int i = 0; i < reader->depth && used < sizeof key; i++) {
        Step step = reader->path[i];
        used += (size_t)(step.key ? snprintf(key + used, sizeof key - used, "%s%s", i ? "." : "",
                                             step.key)
                                  : snprintf(key + used, sizeof key - used, "[%zu]", step.index));
    }
    make_printable(key);
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(reason, sizeof reason, format, arguments);
    va_end(arguments);
    refuse_at_line(reader, line_of_path(reader), key, reason);
}

static void enter(Reader *reader, const char *key, size_t index)
{
    reader->path[reader->depth++] = (Step){key, index};
}

static void leave(Reader *reader)
{
    reader->depth--;
}

static void refuse_key(Reader *reader, const char *key, const char *reason)
{
    enter(reader, key, 0);
    refuse(reader, "%s", reason);
    leave(reader);
}

/* ---- JSON values, checked ---- */

/* keys: NULL-terminated; an optional one is written "?key". */
static void check_keys(Reader *reader, const json_t *object, const char *const keys[])
{
    if (reader->refused)
        return;
    if (!json_is_object(object)) {
        refuse(reader, "not of type object");
        return;
    }
    for (void *it = json_object_iter((json_t *)object); it;
         it = json_object_iter_next((json_t *)object, it)) {
        const char *found = json_object_iter_key(it);
        int i = 0;
        while (keys[i] && strcmp(keys[i] + (*keys[i] == '?'), found) != 0)
            i++;
        if (!keys[i])
            refuse_key(reader, found, "unknown key");
    }
    for (int i = 0; keys[i]; i++)
        if (*keys[i] != '?' && !json_object_get(object, keys[i]))
            refuse(reader, "the key \"%s\" is missing", keys[i]);
}

static double read_number(Reader *reader, const json_t *value, double low, double high)
{
    if (reader->refused)
        return 0;
    if (!json_is_real(value)) {
        refuse(reader, "not of type number");
        return 0;
    }
    double number = json_real_value(value);
    if (!(number >= low && number <= high)) {
        refuse(reader, "%.17g is not from %g to %g", number, low, high);
        return 0;
    }
    return number;
}

static double get_number(Reader *reader, const json_t *object, const char *key, double low,
                         double high)
{
    enter(reader, key, 0);
    double number = read_number(reader, json_object_get(object, key), low, high);
    leave(reader);
    return number;
}

static int get_pixels(Reader *reader, const json_t *object, const char *key)
{
    double number = get_number(reader, object, key, 1, 16384);
    if (number != floor(number))
        refuse_key(reader, key, "not of type integer");
    return (int)number;
}

static Vec3d get_triple(Reader *reader, const json_t *object, const char *key, double low,
                        double high)
{
    double v[3] = {0, 0, 0};
    const json_t *array = json_object_get(object, key);
    enter(reader, key, 0);
    if (!reader->refused && (!json_is_array(array) || json_array_size(array) != 3))
        refuse(reader, "not an array of 3 numbers");
    for (size_t i = 0; i < 3 && !reader->refused; i++) {
        enter(reader, NULL, i);
        v[i] = read_number(reader, json_array_get(array, i), low, high);
        leave(reader);
    }
    leave(reader);
    return (Vec3d){v[0], v[1], v[2]};
}

static Vec3d get_point(Reader *reader, const json_t *object, const char *key)
{
    return get_triple(reader, object, key, -MAX_COORDINATE, MAX_COORDINATE);
}

static Vec3d get_color(Reader *reader, const json_t *object, const char *key)
{
    return get_triple(reader, object, key, 0, MAX_COLOR);
}

/* ^[a-z][a-z0-9_]{0,39}$, and none of the names that figures use for regions */
static void get_name(Reader *reader, const json_t *object, char name[MAX_NAME + 1])
{
    static const char *const RESERVED[] = {"all",   "lit",        "penumbra",
                                           "umbra", "silhouette", "background"};
    const json_t *value = json_object_get(object, "name");
    enter(reader, "name", 0);
    const char *text = json_is_string(value) ? json_string_value(value) : "";
    size_t length = strlen(text);
    if (!reader->refused && (length < 1 || length > MAX_NAME || *text < 'a' || *text > 'z' ||
                             strspn(text, "abcdefghijklmnopqrstuvwxyz0123456789_") != length))
        refuse(reader, "not a name of a letter a-z, then up to 39 of a-z, 0-9 and _");
    for (size_t i = 0; i < sizeof RESERVED / sizeof *RESERVED; i++)
        if (strcmp(text, RESERVED[i]) == 0)
            refuse(reader, "\"%s\" is a reserved name", text);
    snprintf(name, MAX_NAME + 1, "%s", text);
    leave(reader);
}

static void check_description(Reader *reader, const json_t *root)
{
    const json_t *value = json_object_get(root, "description");
    if (!value)
        return;
    size_t characters = 0;
    for (const char *c = json_is_string(value) ? json_string_value(value) : ""; *c; c++)
        characters += ((unsigned char)*c & 0xC0) != 0x80; /* not a UTF-8 continuation */
    if (!json_is_string(value))
        refuse_key(reader, "description", "not of type string");
    else if (characters > MAX_DESCRIPTION)
        refuse_key(reader, "description", "longer than 1000 characters");
}

/* An optional array of at most MAX_ITEMS; NULL and count 0 where it is left out. */
static const json_t *get_items(Reader *reader, const json_t *root, const char *key, int *count)
{
    const json_t *array = json_object_get(root, key);
    *count = 0;
    if (!array)
        return NULL;
    if (!json_is_array(array))
        refuse_key(reader, key, "not of type array");
    else if (json_array_size(array) > MAX_ITEMS)
        refuse_key(reader, key, "more than 1000 items");
    else
        *count = (int)json_array_size(array);
    return array;
}

/* Refuses a name that an earlier item of any of these arrays bears; groups ends with NULL. */
static void check_unique(Reader *reader, const json_t *root, const char *const groups[],
                         const char *kind)
{
    const json_t *seen = json_object();
    for (int g = 0; groups[g] && !reader->refused; g++) {
        const json_t *array = json_object_get(root, groups[g]);
        for (size_t i = 0; i < json_array_size(array) && !reader->refused; i++) {
            const json_t *name = json_object_get(json_array_get(array, i), "name");
            enter(reader, groups[g], 0);
            enter(reader, NULL, i);
            enter(reader, "name", 0);
            if (json_object_get(seen, json_string_value(name)))
                refuse(reader, "there is already a %s named \"%s\"", kind, json_string_value(name));
            json_object_set_new((json_t *)seen, json_string_value(name), json_true());
            reader->depth -= 3;
        }
    }
    json_decref((json_t *)seen);
}

/* ---- vectors, in the Python reader's order of operations: both give the same bits ---- */

static Vec3d divided(Vec3d v, double by)
{
    return (Vec3d){v.x / by, v.y / by, v.z / by};
}

static Vec3d unit(Reader *reader, const char *key, Vec3d v)
{
    double length = vec3d_length(v);
    if (length < MIN_LENGTH) {
        refuse_key(reader, key, "a zero vector has no direction");
        return v;
    }
    return divided(v, length);
}

static Vec3 to_vec3(Vec3d v)
{
    return (Vec3){(real)v.x, (real)v.y, (real)v.z};
}

static Rgb to_rgb(Vec3d v)
{
    return (Rgb){(real)v.x, (real)v.y, (real)v.z};
}

/* ---- the dump ---- */

static void put(Reader *reader, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(NULL, 0, format, arguments);
    va_end(arguments);
    size_t needed = reader->dump_length + (size_t)length + 1;
    if (needed > reader->dump_size) {
        char *larger = realloc(reader->dump, 2 * needed);
        if (!larger) {
            refuse_at_line(reader, 0, "", "out of memory");
            return;
        }
        reader->dump = larger;
        reader->dump_size = 2 * needed;
    }
    va_start(arguments, format);
    vsnprintf(reader->dump + reader->dump_length, (size_t)length + 1, format, arguments);
    va_end(arguments);
    reader->dump_length += (size_t)length;
}

static void put_number(Reader *reader, const char *key, double value)
{
    put(reader, ", \"%s\": %.17g", key, value + 0.0); /* + 0.0 turns -0 into 0 */
}

static void put_triple(Reader *reader, const char *key, Vec3d v)
{
    put(reader, "\"%s\": [%.17g, %.17g, %.17g]", key, v.x + 0.0, v.y + 0.0, v.z + 0.0);
}

static void put_item(Reader *reader, size_t index, const char *name)
{
    put(reader, "%s\n    {\"name\": \"%s\"", index ? "," : "", name);
}

static void put_field(Reader *reader, const char *key, Vec3d v)
{
    put(reader, ", ");
    put_triple(reader, key, v);
}

/* ---- the scene's parts: from the lab's numbers to SI ---- */

/* Reads every item of an array with `read`, between the dump's brackets. Shapes that came later
 * stand in the dump only where a scene has them: hashes stay. */
typedef void ReadItem(Reader *reader, const json_t *item, size_t index, void *out);
typedef enum { DUMP_ALWAYS, DUMP_IF_ANY } DumpItems;

static int read_items(Reader *reader, const json_t *root, const char *key, DumpItems dump,
                      ReadItem *read, void *items, size_t item_size)
{
    int count;
    const json_t *array = get_items(reader, root, key, &count);
    if (count == 0 && dump == DUMP_IF_ANY)
        return 0;
    put(reader, ",\n  \"%s\": [", key);
    for (size_t i = 0; i < (size_t)count && !reader->refused; i++) {
        enter(reader, key, 0);
        enter(reader, NULL, i);
        read(reader, json_array_get(array, i), i, (char *)items + i * item_size);
        reader->depth -= 2;
    }
    put(reader, count ? "\n  ]" : "]");
    return count;
}

static void read_sphere(Reader *reader, const json_t *item, size_t index, void *out)
{
    static const char *const KEYS[] = {"name", "center", "radius", "color", NULL};
    char name[MAX_NAME + 1];
    check_keys(reader, item, KEYS);
    get_name(reader, item, name);
    Vec3d center = get_point(reader, item, "center");
    double radius = get_number(reader, item, "radius", MIN_LENGTH, MAX_COORDINATE);
    Vec3d brdf = get_color(reader, item, "color");
    put_item(reader, index, name);
    put_field(reader, "center", center);
    put_number(reader, "radius", radius);
    put_field(reader, "brdf", brdf);
    put(reader, "}");
    *(Sphere *)out = (Sphere){to_vec3(center), (real)radius, to_rgb(brdf)};
}

static void read_plane(Reader *reader, const json_t *item, size_t index, void *out)
{
    static const char *const KEYS[] = {"name", "point", "normal", "color", NULL};
    char name[MAX_NAME + 1];
    check_keys(reader, item, KEYS);
    get_name(reader, item, name);
    Vec3d point = get_point(reader, item, "point");
    Vec3d normal = unit(reader, "normal", get_point(reader, item, "normal"));
    Vec3d brdf = get_color(reader, item, "color");
    put_item(reader, index, name);
    put_field(reader, "point", point);
    put_field(reader, "normal", normal);
    put_field(reader, "brdf", brdf);
    put(reader, "}");
    *(Plane *)out = (Plane){to_vec3(point), to_vec3(normal), to_rgb(brdf)};
}

/* color * power: a surface's radiance [W m^-2 sr^-1], a point light's radiant intensity [W sr^-1] */
static Vec3d color_times_power(Reader *reader, const json_t *item)
{
    Vec3d color = get_color(reader, item, "color");
    double power = get_number(reader, item, "power", 0, MAX_POWER);
    Vec3d product = {color.x * power, color.y * power, color.z * power};
    if (fmax(product.x, fmax(product.y, product.z)) > MAX_RADIANCE)
        refuse_key(reader, "power", "color * power is over 1e+30");
    return product;
}

static void read_point_light(Reader *reader, const json_t *item, size_t index, void *out)
{
    static const char *const KEYS[] = {"name", "position", "color", "power", NULL};
    char name[MAX_NAME + 1];
    check_keys(reader, item, KEYS);
    get_name(reader, item, name);
    Vec3d position = get_point(reader, item, "position");
    Vec3d radiant_intensity = color_times_power(reader, item);
    put_item(reader, index, name);
    put_field(reader, "position", position);
    put_field(reader, "radiant_intensity", radiant_intensity);
    put(reader, "}");
    *(Light *)out = (Light){LIGHT_POINT, {.point = {to_vec3(position), to_rgb(radiant_intensity)}}};
}

/* The last two fields of every light that is a surface. */
static void put_emission(Reader *reader, double area, Vec3d radiance)
{
    put_number(reader, "area", area);
    put_field(reader, "radiance", radiance);
    put(reader, "}");
}

/* A quad, or the triangle that is half of it. */
static FlatLight read_flat_light(Reader *reader, const json_t *item, size_t index,
                                 const char *shape, double share)
{
    static const char *const KEYS[] = {"name", "position", "u", "v", "color", "power", NULL};
    char name[MAX_NAME + 1];
    check_keys(reader, item, KEYS);
    get_name(reader, item, name);
    const Vec3d corner = get_point(reader, item, "position");
    const Vec3d u = get_point(reader, item, "u"), v = get_point(reader, item, "v");
    unit(reader, "u", u);
    unit(reader, "v", v);
    Vec3d normal = vec3d_cross(u, v);
    const double quad_area = vec3d_length(normal), area = share * quad_area;
    if (quad_area <= MIN_LENGTH * vec3d_length(u) * vec3d_length(v)) {
        char reason[60];
        snprintf(reason, sizeof reason, "u and v are parallel: the %s has no area", shape);
        refuse_key(reader, "v", reason);
    } else {
        normal = divided(normal, quad_area);
    }
    const Vec3d radiance = color_times_power(reader, item);
    put_item(reader, index, name);
    put_field(reader, "corner", corner);
    put_field(reader, "edge_u", u);
    put_field(reader, "edge_v", v);
    put_field(reader, "normal", normal);
    put_emission(reader, area, radiance);
    return (FlatLight){to_vec3(corner), to_vec3(u), to_vec3(v),
                       to_vec3(normal), (real)area, to_rgb(radiance)};
}

static void read_quad_light(Reader *reader, const json_t *item, size_t index, void *out)
{
    const QuadLight quad = read_flat_light(reader, item, index, "quad", 1);
    *(Light *)out = (Light){LIGHT_QUAD, {.quad = quad}};
}

static void read_triangle_light(Reader *reader, const json_t *item, size_t index, void *out)
{
    const TriangleLight triangle = read_flat_light(reader, item, index, "triangle", 0.5);
    *(Light *)out = (Light){LIGHT_TRIANGLE, {.triangle = triangle}};
}

static void read_disk_light(Reader *reader, const json_t *item, size_t index, void *out)
{
    static const char *const KEYS[] = {"name",  "center", "normal", "radius",
                                       "color", "power",  NULL};
    char name[MAX_NAME + 1];
    check_keys(reader, item, KEYS);
    get_name(reader, item, name);
    Vec3d center = get_point(reader, item, "center");
    Vec3d normal = unit(reader, "normal", get_point(reader, item, "normal"));
    double radius = get_number(reader, item, "radius", MIN_LENGTH, MAX_COORDINATE);
    double area = PI * radius * radius;
    Vec3d radiance = color_times_power(reader, item);
    put_item(reader, index, name);
    put_field(reader, "center", center);
    put_field(reader, "normal", normal);
    put_number(reader, "radius", radius);
    put_emission(reader, area, radiance);
    *(Light *)out = (Light){
        LIGHT_DISK,
        {.disk = {to_vec3(center), to_vec3(normal), (real)radius, (real)area, to_rgb(radiance)}}};
}

static void read_sphere_light(Reader *reader, const json_t *item, size_t index, void *out)
{
    static const char *const KEYS[] = {"name", "center", "radius", "color", "power", NULL};
    char name[MAX_NAME + 1];
    check_keys(reader, item, KEYS);
    get_name(reader, item, name);
    Vec3d center = get_point(reader, item, "center");
    double radius = get_number(reader, item, "radius", MIN_LENGTH, MAX_COORDINATE);
    double area = 4 * PI * radius * radius;
    Vec3d radiance = color_times_power(reader, item);
    put_item(reader, index, name);
    put_field(reader, "center", center);
    put_number(reader, "radius", radius);
    put_emission(reader, area, radiance);
    *(Light *)out = (Light){
        LIGHT_SPHERE, {.sphere = {to_vec3(center), (real)radius, (real)area, to_rgb(radiance)}}};
}

/* Every shape of light, in the order in which a scene holds them: an index decides which random
 * numbers a light gets. */
enum { LIGHT_SHAPES = 5 };
static const char *const LIGHT_KEYS[LIGHT_SHAPES + 1] = {
    "point_lights", "quad_lights", "disk_lights", "triangle_lights", "sphere_lights", NULL};
static ReadItem *const READ_LIGHT[LIGHT_SHAPES] = {
    read_point_light, read_quad_light, read_disk_light, read_triangle_light, read_sphere_light};

static void read_lights(Reader *reader, const json_t *root, Scene *scene)
{
    for (int shape = 0; shape < LIGHT_SHAPES; shape++)
        scene->nb_lights +=
            read_items(reader, root, LIGHT_KEYS[shape], shape < 2 ? DUMP_ALWAYS : DUMP_IF_ANY,
                       READ_LIGHT[shape], scene->lights + scene->nb_lights, sizeof *scene->lights);
    check_unique(reader, root, LIGHT_KEYS, "light");
}

static Camera read_camera(Reader *reader, const json_t *root)
{
    static const char *const KEYS[] = {"position", "look_at", "up", "fov_y_deg", NULL};
    const json_t *item = json_object_get(root, "camera");
    enter(reader, "camera", 0);
    check_keys(reader, item, KEYS);
    Vec3d position = get_point(reader, item, "position");
    Vec3d look_at = get_point(reader, item, "look_at");
    Vec3d up = unit(reader, "up", get_point(reader, item, "up"));
    double fov_y_deg = get_number(reader, item, "fov_y_deg", 0.001, 179);
    Vec3d forward = unit(reader, "look_at", vec3d_sub(look_at, position));
    Vec3d right = vec3d_cross(up, forward);
    if (vec3d_length(right) <= MIN_LENGTH)
        refuse_key(reader, "up", "up is parallel to the view direction");
    else
        right = divided(right, vec3d_length(right));
    up = vec3d_cross(forward, right);
    leave(reader);

    put(reader, "  \"camera\": {");
    put_triple(reader, "position", position);
    put_field(reader, "forward", forward);
    put_field(reader, "right", right);
    put_field(reader, "up", up);
    put_number(reader, "fov_y_deg", fov_y_deg);
    put(reader, "},\n");
    return (Camera){to_vec3(position), to_vec3(forward), to_vec3(right), to_vec3(up),
                    (real)tan(fov_y_deg * DEGREE / 2)};
}

static void read_scene(Reader *reader, const json_t *root, Scene *scene)
{
    static const char *const KEYS[] = {"name",           "?description",
                                       "image",          "camera",
                                       "background",     "ray_max_distance",
                                       "?spheres",       "?planes",
                                       "?point_lights",  "?quad_lights",
                                       "?disk_lights",   "?triangle_lights",
                                       "?sphere_lights", NULL};
    static const char *const OBJECT_KEYS[] = {"spheres", "planes", NULL};
    static const char *const IMAGE_KEYS[] = {"width", "height", NULL};

    check_keys(reader, root, KEYS);
    get_name(reader, root, scene->name);
    check_description(reader, root);

    const json_t *image = json_object_get(root, "image");
    enter(reader, "image", 0);
    check_keys(reader, image, IMAGE_KEYS);
    scene->width = get_pixels(reader, image, "width");
    scene->height = get_pixels(reader, image, "height");
    leave(reader);

    scene->camera = read_camera(reader, root);
    Vec3d background = get_color(reader, root, "background");
    put(reader, "  ");
    put_triple(reader, "background_radiance", background);
    double ray_max_distance =
        get_number(reader, root, "ray_max_distance", MIN_LENGTH, MAX_COORDINATE);
    put(reader, ",\n  \"ray_max_distance\": %.17g", ray_max_distance);
    scene->background = to_rgb(background);
    scene->ray_max_distance = (real)ray_max_distance;

    scene->spheres = calloc(MAX_ITEMS, sizeof *scene->spheres);
    scene->planes = calloc(MAX_ITEMS, sizeof *scene->planes);
    scene->lights = calloc(LIGHT_SHAPES * MAX_ITEMS, sizeof *scene->lights);
    if (!scene->spheres || !scene->planes || !scene->lights) {
        refuse_at_line(reader, 0, "", "out of memory");
        return;
    }
    scene->nb_spheres = read_items(reader, root, "spheres", DUMP_ALWAYS, read_sphere,
                                   scene->spheres, sizeof *scene->spheres);
    scene->nb_planes = read_items(reader, root, "planes", DUMP_ALWAYS, read_plane, scene->planes,
                                  sizeof *scene->planes);
    check_unique(reader, root, OBJECT_KEYS, "object");
    read_lights(reader, root, scene);
    put(reader, "\n");
}

/* ---- the file ---- */

/* Windows' editors begin a file with a mark of its encoding, which JSON has no place for. */
static void skip_byte_order_mark(Reader *reader)
{
    if (reader->length >= 3 && memcmp(reader->text, "\xEF\xBB\xBF", 3) == 0) {
        reader->length -= 3;
        memmove(reader->text, reader->text + 3, reader->length + 1);
    } else if (reader->length >= 2 && (memcmp(reader->text, "\xFF\xFE", 2) == 0 ||
                                       memcmp(reader->text, "\xFE\xFF", 2) == 0)) {
        refuse_at_line(reader, 1, "", "UTF-16 text: save it as UTF-8");
    }
}

static void read_text(Reader *reader)
{
    FILE *stream = fopen(reader->file, "rb");
    reader->text = stream ? malloc(MAX_BYTES + 1) : NULL;
    if (reader->text) {
        reader->length = fread(reader->text, 1, MAX_BYTES + 1, stream);
        if (ferror(stream))
            refuse_at_line(reader, 0, "", strerror(errno));
        else if (reader->length > MAX_BYTES)
            refuse_at_line(reader, 0, "", "larger than 1048576 bytes: not a scene");
        else
            reader->text[reader->length] = '\0';
    } else {
        refuse_at_line(reader, 0, "", strerror(errno));
    }
    if (stream)
        fclose(stream);
    if (!reader->refused)
        skip_byte_order_mark(reader);
    /* Jansson skips a NUL byte after a number, where strings of C end. */
    const char *nul = reader->refused ? NULL : memchr(reader->text, '\0', reader->length);
    if (nul)
        refuse_at_line(reader, line_of(reader, nul), "", "NUL byte: not JSON text");
}

static void fnv1a(const char *text, char hexadecimal[17])
{
    uint64_t hash = UINT64_C(0xCBF29CE484222325);
    for (; *text; text++)
        hash = (hash ^ (unsigned char)*text) * UINT64_C(0x100000001B3);
    snprintf(hexadecimal, 17, "%016" PRIx64, hash);
}

/* name, hash and size in front of the body that the hash is taken of */
static char *whole_dump(Reader *reader, const Scene *scene)
{
    char *body = reader->dump;
    reader->dump = NULL;
    reader->dump_length = reader->dump_size = 0;
    put(reader, "{\n  \"name\": \"%s\",\n  \"hash\": \"%s\",\n  \"image\": [%d, %d],\n%s}\n",
        scene->name, scene->hash, scene->width, scene->height, body);
    free(body);
    return reader->dump;
}

bool scene_read(const char *file, Scene *scene, char **dump, char *message, size_t message_size)
{
    Reader reader = {.file = file, .message = message, .message_size = message_size};
    *scene = (Scene){0};

    read_text(&reader);
    json_t *root = NULL;
    if (!reader.refused) {
        json_error_t error;
        root = json_loadb(reader.text, reader.length,
                          JSON_REJECT_DUPLICATES | JSON_DECODE_INT_AS_REAL, &error);
        if (!root) {
            make_printable(error.text);
            refuse_at_line(&reader, error.line > 0 ? error.line : 1, "", error.text);
        }
    }
    if (!reader.refused)
        read_scene(&reader, root, scene);
    if (!reader.refused) {
        fnv1a(reader.dump, scene->hash);
        if (dump)
            *dump = whole_dump(&reader, scene);
    }
    json_decref(root);
    free(reader.text);
    if (reader.refused || !dump)
        free(reader.dump);
    if (reader.refused)
        scene_free(scene);
    return !reader.refused;
}
