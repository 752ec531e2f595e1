#version 420 core
// The light of a pixel: the mean over its samples, each shaded by the shared surface model.
//
// f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c), layers mixed from the base up.
// All positions are relative to the camera; axes are the world's.

const float PI = 3.14159265358979;

layout(binding = 0) uniform usampler2D ids;            // (slot + 1, face) of each sample; 0 is nothing.
layout(binding = 1) uniform samplerBuffer poses;       // Four texels a slot: a 3x4 matrix, then (mesh, variation).
layout(binding = 2) uniform usamplerBuffer faces;      // Vertex indices within the mesh.
layout(binding = 3) uniform samplerBuffer vertices;    // Position and variation.
layout(binding = 4) uniform samplerBuffer normals;     // Shading normals; unused where a mesh has none.
layout(binding = 5) uniform samplerBuffer weights;     // Merge by merge, of all vertices of a mesh.
layout(binding = 6) uniform usamplerBuffer meshes;     // Two texels a mesh, see tables.py.
layout(binding = 7) uniform usamplerBuffer layers;     // Surfaces of the meshes.
layout(binding = 8) uniform samplerBuffer surfaces;    // Four texels a surface, see tables.py.
layout(binding = 9) uniform sampler2D gloss_albedo;    // Albedo of a white GGX lobe over (cosine, roughness).
layout(binding = 10) uniform sampler2DArray maps;
layout(binding = 11) uniform sampler2DArrayShadow shadows;

#ifdef WITH_UV
layout(binding = 14) uniform samplerBuffer uvs;        // Two texels a face: its corners' coordinates.
#endif
#ifdef WITH_REFLECTANCE
layout(binding = 15) uniform sampler2D laws;          // See laws.py.
#endif
#ifdef WITH_GROUND
layout(binding = 12) uniform sampler2D ground_sky;    // Share of the sky, and of ground above.
layout(binding = 13) uniform sampler2D ground_light;  // Radiance of the ground about.
uniform float ground_share;          // 0 leaves its light out.
uniform vec4 ground_place;         // From x and y to their coordinates: scale, then offset.
#endif
uniform int samples;               // Per side of a pixel.
uniform mat3 rays;                 // (u, v, 1) in pixels to a direction.
uniform vec3 sky[9];               // Irradiance as spherical harmonics of the normal.
uniform vec3 sky_mirrored[9];      // Radiance likewise, of the direction.
#ifdef WITH_LAMPS
// A lamp in place of the sun, as each hit sees it: set by find_lamp.
vec3 to_sun;
vec3 sun;
float sun_alpha;
uniform vec3 lamp_position;
uniform vec3 lamp_axis;
uniform vec3 lamp;                 // Intensity on the axis.
uniform vec4 lamp_cone;            // Angles where it begins to fade and ends, 1 / ramp, radius.
uniform float least_alpha;
#else
uniform vec3 to_sun;
uniform vec3 sun;                  // Irradiance facing it.
uniform float sun_alpha;           // Least alpha of a lobe that shows it: its disc's width.
#endif
uniform mat4 shadow_clip[CASCADES];
uniform vec2 shadow_texel[CASCADES];  // Size in meters, and bias in depth.
uniform int cascades;

layout(location = 0) out vec4 light;

struct Hit {
    vec3 position;
    vec3 view;      // To the camera.
    vec3 flat_normal;  // Towards the camera.
    vec3 normal;    // As authored.
    vec3 share;     // Barycentric coordinates.
    uvec3 corner;   // Vertices.
    uint mesh;
    float variation;   // Of the vertices,
    float row;         // and of the row.
    int number;        // Which sample of its pixel it is.
    vec3 right;        // Edges of the sample on the face,
    vec3 down;         // meters.
#ifdef WITH_UV
    vec2 uv;
    vec2 uv_right;     // The edges in the picture.
    vec2 uv_down;
    vec3 along_u;      // dP/du and dP/dv, of any length.
    vec3 along_v;
#endif
};

vec3 placed(int slot, vec3 point)
{
    vec4 p = vec4(point, 1.0);
    return vec3(
        dot(texelFetch(poses, 4 * slot), p),
        dot(texelFetch(poses, 4 * slot + 1), p),
        dot(texelFetch(poses, 4 * slot + 2), p)
    );
}

#ifdef WITH_UV
// What a vector on a face is in the picture.
vec2 across(vec3 edge, vec3 ab, vec3 ac, vec3 area, vec2 first, vec2 second)
{
    vec2 bary = vec2(dot(cross(edge, ac), area), dot(cross(ab, edge), area)) / dot(area, area);
    return bary.x * first + bary.y * second;
}

void find_uv(inout Hit hit, int at, vec3 ab, vec3 ac)
{
    vec3 one = texelFetch(uvs, 2 * at).xyz;
    vec3 two = texelFetch(uvs, 2 * at + 1).xyz;
    hit.uv = hit.share.x * one.xy + hit.share.y * vec2(one.z, two.x) + hit.share.z * two.yz;
    vec2 first = vec2(one.z, two.x) - one.xy;
    vec2 second = two.yz - one.xy;
    float turn = sign(first.x * second.y - first.y * second.x);
    hit.along_u = turn * (second.y * ab - first.y * ac);
    hit.along_v = turn * (first.x * ac - second.x * ab);
    vec3 area = cross(ab, ac);
    hit.uv_right = across(hit.right, ab, ac, area, first, second);
    hit.uv_down = across(hit.down, ab, ac, area, first, second);
}
#endif

Hit find(uvec2 id, vec3 direction)
{
    Hit hit;
    int slot = int(id.x) - 1;
    vec4 row = texelFetch(poses, 4 * slot + 3);
    hit.mesh = uint(row.x);
    uvec4 mesh = texelFetch(meshes, 2 * int(hit.mesh));
    uvec3 face = texelFetch(faces, int(mesh.y + id.y)).xyz;
    hit.corner = face + mesh.x;
    vec4 va = texelFetch(vertices, int(hit.corner.x));
    vec4 vb = texelFetch(vertices, int(hit.corner.y));
    vec4 vc = texelFetch(vertices, int(hit.corner.z));
    vec3 a = placed(slot, va.xyz);
    vec3 ab = placed(slot, vb.xyz) - a;
    vec3 ac = placed(slot, vc.xyz) - a;
    // Moeller and Trumbore 1997; the sample lies on the face but for rounding.
    vec3 p = cross(direction, ac);
    float scale = 1.0 / dot(ab, p);
    vec3 q = cross(-a, ab);
    vec2 bary = vec2(dot(-a, p), dot(direction, q)) * scale;
    bary = isnan(bary.x + bary.y) ? vec2(1.0 / 3.0) : clamp(bary, 0.0, 1.0);
    bary /= max(1.0, bary.x + bary.y);
    hit.share = vec3(1.0 - bary.x - bary.y, bary);
    hit.position = a + bary.x * ab + bary.y * ac;
    hit.view = -normalize(direction);
    vec3 m0 = texelFetch(poses, 4 * slot).xyz;
    vec3 m1 = texelFetch(poses, 4 * slot + 1).xyz;
    vec3 m2 = texelFetch(poses, 4 * slot + 2).xyz;
    // A mirrored row turns the winding.
    float handed = dot(m0, cross(m1, m2)) < 0.0 ? -1.0 : 1.0;
    vec3 outward = handed * normalize(cross(ab, ac));
    hit.normal = outward;
    if ((mesh.w & 1u) != 0u) {
        vec3 n = hit.share.x * texelFetch(normals, int(hit.corner.x)).xyz
            + hit.share.y * texelFetch(normals, int(hit.corner.y)).xyz
            + hit.share.z * texelFetch(normals, int(hit.corner.z)).xyz;
        n = handed * vec3(dot(cross(m1, m2), n), dot(cross(m2, m0), n), dot(cross(m0, m1), n));
        float length2 = dot(n, n);
        if (length2 > 0.0)
            hit.normal = n * inversesqrt(length2);
    }
    hit.flat_normal = dot(outward, hit.view) < 0.0 ? -outward : outward;
    hit.row = row.y;
#ifdef WITH_MAPS
    vec3 dx = rays[0] / float(samples);
    vec3 dy = rays[1] / float(samples);
    float along = dot(outward, direction);
    float t = dot(hit.position, direction) / dot(direction, direction);
    hit.right = t * (dx - direction * (dot(outward, dx) / along));
    hit.down = t * (dy - direction * (dot(outward, dy) / along));
#endif
#ifdef WITH_UV
    // 0 in the table: the mesh has no coordinates, and all its corners are at (0, 0).
    int first_uv = int(texelFetch(meshes, 2 * int(hit.mesh) + 1).w);
    find_uv(hit, first_uv == 0 ? 0 : first_uv + int(id.y), ab, ac);
#endif
    hit.variation = dot(hit.share, vec3(va.w, vb.w, vc.w));
    return hit;
}

// What comes from all around to a hit: the sky, and the ground where there is any.
struct Around {
    vec3 share;   // Of the sky.
    vec3 ground;  // Radiance of the ground.
    float taken;  // Share of the cosine that is ground.
};

Around around_of(Hit hit)
{
    Around around;
    around.share = vec3(1.0);
    around.ground = vec3(0.0);
    around.taken = 0.0;
#ifdef WITH_GROUND
    vec2 place = hit.position.xy * ground_place.xy + ground_place.zw;
    vec4 share = texture(ground_sky, place);
    around.share = share.rgb;
    // What a normal map leans sees no more ground for it.
    float up = dot(hit.normal, hit.flat_normal) < 0.0 ? -hit.normal.z : hit.normal.z;
    around.taken = share.a + 0.5 - 0.5 * up;
    around.ground = ground_share * texture(ground_light, place).rgb;
#endif
    return around;
}

vec3 irradiance_of(vec3 n, Around around)
{
    vec3 open = max(
        sky[0] + sky[1] * n.y + sky[2] * n.z + sky[3] * n.x + sky[4] * (n.x * n.y)
            + sky[5] * (n.y * n.z) + sky[6] * (3.0 * n.z * n.z - 1.0) + sky[7] * (n.x * n.z)
            + sky[8] * (n.x * n.x - n.y * n.y),
        0.0
    );
    return around.share * open + PI * around.taken * around.ground;
}

#ifdef WITH_LAMPS
void find_lamp(vec3 at)
{
    vec3 way = lamp_position - at;
    float squared = max(dot(way, way), 1e-20);
    to_sun = way * inversesqrt(squared);
    float angle = 2.0 * asin(min(0.5 * length(to_sun + lamp_axis), 1.0));
    float x = clamp((angle - lamp_cone.x) * lamp_cone.z, 0.0, 1.0);
    bool shines = angle <= lamp_cone.y && squared > lamp_cone.w * lamp_cone.w;
    sun = shines ? lamp * ((1.0 - x * x * (3.0 - 2.0 * x)) / squared) : vec3(0.0);
    sun_alpha = max(least_alpha, 0.5 * lamp_cone.w * inversesqrt(squared));
}
#endif

// How much of the sun arrives at a hit: the finest shadow map that holds it, filtered.
float sunlit(Hit hit)
{
    float slope = dot(hit.flat_normal, to_sun);
    float turn = sqrt(max(1.0 - slope * slope, 0.0));
    // Sampled once, after the choice: software runs all of a loop's and a branch's instructions.
    vec4 place = vec4(0.0);
    bool found = false;
    for (int c = 0; c < CASCADES; c++) {
        // Along the surface's normal: no surface shades itself by what a texel is wide.
#ifdef WITH_LAMPS
        // Texels lie across the map's axis and grow along it; depth is the inverse.
        mat4 m = shadow_clip[c];
        float along = dot(hit.flat_normal, vec3(m[0][3], m[1][3], m[2][3]));
        float apart = max((m * vec4(hit.position, 1.0)).w, 0.0);
        turn = sqrt(max(1.0 - along * along, 0.0));
        vec3 lifted = hit.position + hit.flat_normal * (shadow_texel[c].x * apart * 1.5 * turn);
        vec4 clip = shadow_clip[c] * vec4(lifted, 1.0);
        vec3 p = clip.w > 0.0 ? clip.xyz / clip.w : vec3(-2.0);
        float bias = shadow_texel[c].y * p.z;
#else
        vec3 lifted = hit.position + hit.flat_normal * (shadow_texel[c].x * 1.5 * turn);
        vec3 p = (shadow_clip[c] * vec4(lifted, 1.0)).xyz;
        float bias = shadow_texel[c].y;
#endif
        p.xy = 0.5 * p.xy + 0.5;
        bool inside = c < cascades && all(greaterThanEqual(p, vec3(0.0)))
            && all(lessThanEqual(p, vec3(1.0)));
        if (inside && !found)
            place = vec4(p.xy, float(c), p.z + bias);
        found = found || inside;
    }
    float lit = 0.0;
    vec2 texel = 0.5 / vec2(textureSize(shadows, 0).xy);
    // Four places in a pixel: those of its samples, or all of them at its only one.
    int places = samples == 1 ? 4 : 1;
    for (int k = 0; k < places; k++) {
        int i = k + hit.number;
        vec2 shift = texel * vec2(float(i & 1) * 2.0 - 1.0, float(i >> 1 & 1) * 2.0 - 1.0);
        lit += texture(shadows, vec4(place.xy + shift, place.zw));
    }
#ifdef WITH_LAMPS
    // What no map holds is lit in another pass, or not at all.
    return slope <= 0.0 || !found ? 0.0 : lit / float(places);
#else
    return slope <= 0.0 ? 0.0 : found ? lit / float(places) : 1.0;
#endif
}

float hidden(float cosine, float alpha2)
{
    float c2 = cosine * cosine;
    return 0.5 * sqrt(1.0 + alpha2 * (1.0 - c2) / c2) - 0.5;
}

// A white GGX lobe times the cosine, with height-correlated Smith masking (Heitz 2014).
float gloss(float alpha, vec3 n, vec3 v, vec3 l)
{
    float alpha2 = alpha * alpha;
    vec3 h = normalize(v + l);
    float nh = dot(n, h);
    float nv = dot(n, v);
    float nl = dot(n, l);
    float base = (alpha2 - 1.0) * nh * nh + 1.0;
    float density = alpha2 / (PI * base * base);
    return density / ((1.0 + hidden(nv, alpha2) + hidden(nl, alpha2)) * 4.0 * nv);
}

// The sky in a lobe: its albedo times what spherical harmonics keep of the sky about the mirrored
// direction. A lobe of width alpha shrinks band l by exp(-(alpha l)**2) (Ramamoorthi and Hanrahan
// 2001).
vec3 sky_gloss(float roughness, vec3 n, vec3 v, Around around)
{
    float nv = clamp(dot(n, v), 0.0, 1.0);
    vec3 r = reflect(-v, n);
    float alpha = roughness * roughness;
    vec3 radiance = max(sky_mirrored[0]
        + exp(-alpha * alpha)
            * (sky_mirrored[1] * r.y + sky_mirrored[2] * r.z + sky_mirrored[3] * r.x)
        + exp(-4.0 * alpha * alpha)
            * (sky_mirrored[4] * (r.x * r.y) + sky_mirrored[5] * (r.y * r.z)
               + sky_mirrored[6] * (3.0 * r.z * r.z - 1.0) + sky_mirrored[7] * (r.x * r.z)
               + sky_mirrored[8] * (r.x * r.x - r.y * r.y)), 0.0) * around.share;
#ifdef WITH_GROUND
    // What of the lobe is below the horizon, roughly; level ground has nothing of it there.
    float below = clamp(0.5 - r.z / (2.0 * max(alpha, 0.05)), 0.0, 1.0) * clamp(1.0 - n.z, 0.0, 1.0);
    radiance = mix(radiance, around.ground, below);
#endif
    vec2 size = vec2(textureSize(gloss_albedo, 0));
    vec2 node = (vec2(nv, roughness) * (size - 1.0) + 0.5) / size;
    return radiance * texture(gloss_albedo, node).r;
}

// A surface at a hit, or a mixture of several that share roughness and normal.
struct Look {
    vec3 dull;   // Albedo of the Lambert lobe,
    vec3 shine;  // and of the GGX lobe.
    float roughness;
    vec3 normal;  // Towards the camera.
#ifdef WITH_REFLECTANCE
    vec3 color;
    float share;  // Of the dull lobe, whose albedo is color * share where it is Lambert's.
    int law;      // -1: Lambert's.
#endif
#ifdef WITH_HEIGHTS
    float height;
#endif
#ifdef WITH_EMISSION
    vec3 glow;    // What it gives off.
#endif
};

#ifdef WITH_REFLECTANCE
// 1 / H = 1 - w (r0 x + y) for the cosine c.
vec2 inverse_h(float c)
{
    float part = c * log(1.0 + 1.0 / c);
    return vec2(c * (1.0 - part), 0.5 * part);
}

#ifdef WITH_ROUGH_LAWS
// Scale and effective cosines on a surface of mean slope; near is the larger cosine.
float rough_law(float slope, float cos_g, inout float near, inout float far)
{
    float chi = inversesqrt(1.0 + PI * slope * slope);
    vec2 cosine = vec2(near, far);
    vec2 sine = sqrt(max(1.0 - cosine * cosine, 1e-8));
    float cos_psi = clamp((cos_g - near * far) / (sine.x * sine.y), -1.0, 1.0);
    float turned = 0.5 - 0.5 * cos_psi;
    float gate = exp(-2.0 * sqrt(turned / max(1.0 - turned, 1e-6)));
    vec2 cot = cosine / (sine * slope * PI);
    vec2 first = exp(-2.0 * cot);
    vec2 second = exp(-PI * cot * cot);
    vec2 plain = cosine + sine * slope * second / (2.0 - first);
    float lean = slope / (2.0 - first.y - acos(cos_psi) / PI * first.x);
    near = max(near + sine.x * lean * (cos_psi * second.y + turned * second.x), 1e-4);
    far = max(far + sine.y * lean * (second.y - turned * second.x), 1e-4);
    float shadow = 1.0 - gate + gate * (cosine.x / plain.x);
    float scale = 0.25 / PI * near * far / (near + far) / (plain.x * plain.y * shadow);
    near *= chi;
    far *= chi;
    return scale;
}
#endif

// BRDF of a law; backends/reflectance.py is the same, with its sources.
vec3 law_value(int row, vec3 r0, vec3 n, vec3 v)
{
    vec4 numbers = texelFetch(laws, ivec2(0, row), 0);
    vec2 more = texelFetch(laws, ivec2(1, row), 0).xy;
    vec3 apart = v - to_sun;
    vec3 both = v + to_sun;
    // tan(g / 2); a disc blurs it by a third of its radius, which sun_alpha is half of.
    float blur = 2.0 / 3.0 * sun_alpha;
    float t = sqrt(dot(apart, apart) / max(dot(both, both), 1e-6) + blur * blur);
    float cos_g = (1.0 - t * t) / (1.0 + t * t);
    float square = 1.0 + numbers.y * numbers.y;
    float back = square - 2.0 * numbers.y * cos_g;
    float forth = square + 2.0 * numbers.y * cos_g;
    float single = 0.5 * (2.0 - square) * ((1.0 + numbers.z) * inversesqrt(back * back * back)
        + (1.0 - numbers.z) * inversesqrt(forth * forth * forth));
    single *= 1.0 + numbers.w / (1.0 + t / more.x);
    float near = max(max(dot(n, v), dot(n, to_sun)), 1e-4);
    float far = max(min(dot(n, v), dot(n, to_sun)), 1e-4);
    float scale = 0.25 / PI / (near + far);
#ifdef WITH_ROUGH_LAWS
    if (more.y > 0.0)
        scale = rough_law(more.y, cos_g, near, far);
#endif
    vec3 w = 4.0 * r0 / ((1.0 + r0) * (1.0 + r0));
    vec3 total = vec3(single);
    if (numbers.x > 0.0) {
        vec2 one = inverse_h(near);
        vec2 two = inverse_h(far);
        total += 1.0 / ((1.0 - w * (r0 * one.x + one.y)) * (1.0 - w * (r0 * two.x + two.y))) - 1.0;
    }
    return scale * w * total;
}

// Albedo towards the viewer under even light.
vec3 law_albedo(int first, int rows, vec3 r0, float cosine)
{
    vec2 size = vec2(textureSize(laws, 0));
    float u = (clamp(cosine, 0.0, 1.0) * (size.x - 1.0) + 0.5) / size.x;
    vec3 v = (float(first) + 0.5 + r0 * float(rows - 1)) / size.y;
    return r0 * vec3(texture(laws, vec2(u, v.x)).r, texture(laws, vec2(u, v.y)).r,
                     texture(laws, vec2(u, v.z)).r);
}
#endif

#ifdef WITH_MAPS
// Level of the pictures for a sample's edges in repeats: the shorter side of what it covers, and at
// most four times that.
float level_of(vec2 right, vec2 down)
{
    float a = length(right);
    float b = length(down);
    float fine = min(a, b);
    return log2(max(min(max(a, b), 4.0 * fine) * float(textureSize(maps, 0).x), 1e-6));
}

#ifdef WITH_CELLS
// A cell at a point; backends/cells.py defines them.
struct Cell {
    vec2 place;   // In the picture.
    vec2 turn;    // Cosine and sine.
    float share;
    float gain;   // The share over the root of the squares of all.
};

// The three cells at a place in the lattice.
Cell[3] cells_at(vec2 at, vec4 numbers)
{
    vec2 low = floor(at);
    vec2 within = at - low;
    float rest = 1.0 - within.x - within.y;
    float upper = rest <= 0.0 ? 1.0 : 0.0;
    vec3 near = vec3(rest, within + upper * rest);
    near *= near;
    near *= near;
    Cell cells[3];
    for (int k = 0; k < 3; k++) {
        vec2 corner = k == 0 ? vec2(upper) : k == 1 ? vec2(1.0, 0.0) : vec2(0.0, 1.0);
        vec2 away = within - corner;
        away = vec2(away.x + 0.5 * away.y, 0.86602540378 * away.y) * numbers.y;
        ivec2 entry = ivec2(low + corner) & 63;
        vec4 own = texelFetch(surfaces, int(numbers.z) + 64 * entry.y + entry.x);
        cells[k].place = vec2(own.z * away.x - own.w * away.y, own.w * away.x + own.z * away.y)
            + own.xy;
        cells[k].turn = own.zw;
        cells[k].share = near[k] / (near.x + near.y + near.z);
        cells[k].gain = near[k] * inversesqrt(dot(near, near));
    }
    return cells;
}

vec4 mix_cells(Cell[3] cells, float layer, float level, vec4 mean)
{
    vec4 total = mean * (1.0 - cells[0].gain - cells[1].gain - cells[2].gain);
    for (int k = 0; k < 3; k++)
        total += cells[k].gain * textureLod(maps, vec3(cells[k].place, layer), level);
    return max(total, 0.0);
}

// A normal in the first three components, a number in the last.
vec4 mix_normals(Cell[3] cells, float layer, float level, float mean)
{
    vec4 total = vec4(vec3(0.0), mean * (1.0 - cells[0].gain - cells[1].gain - cells[2].gain));
    for (int k = 0; k < 3; k++) {
        vec4 own = textureLod(maps, vec3(cells[k].place, layer), level);
        vec2 t = cells[k].turn;
        vec2 back = vec2(t.x * own.x + t.y * own.y, t.x * own.y - t.y * own.x);
        total += vec4(cells[k].gain * back, cells[k].share * own.z, cells[k].gain * own.a);
    }
    total.a = clamp(total.a, 0.0, 1.0);
    return total;
}

// From the world's x and y to the lattice's, whose sides are one over a step.
vec2 in_lattice(vec2 at, float step)
{
    return vec2(at.x - 0.57735026919 * at.y, 1.15470053838 * at.y) * step;
}
#endif

// The coordinates of a point or a vector on the plane across an axis.
vec2 on_plane(vec3 point, int axis)
{
    return axis == 0 ? point.yz : axis == 1 ? point.xz : point.xy;
}
#endif

Look look_of(int index, Hit hit)
{
    vec4 first = texelFetch(surfaces, 4 * index);
    vec4 second = texelFetch(surfaces, 4 * index + 1);
    float specular = first.a;
    float roughness = second.x;
    float metallic = second.z;
    vec3 color = max(first.rgb * (1.0 + second.y * hit.variation) * (1.0 + second.y * hit.row), 0.0);
    float side = dot(hit.normal, hit.flat_normal) < 0.0 ? -1.0 : 1.0;
    vec3 n = side * hit.normal;
#ifdef WITH_MAPS
    vec4 third = texelFetch(surfaces, 4 * index + 2);
    int block = int(third.w);
#ifdef WITH_THIRD
    vec4 more = vec4(1.0, 1.0, 1.0, 0.5);
#endif
    if (third.x >= 0.0) {
        vec3 at = hit.position * third.z + texelFetch(surfaces, 4 * index + 3).xyz;
        vec4 paint = vec4(1.0);
        vec4 relief = vec4(0.0);
#ifdef WITH_THIRD
        // Without a picture of its own it is looked up in another, and not used.
        float layer = third.w > 0.0 ? texelFetch(surfaces, block).w : 0.0;
#endif
#ifdef WITH_ABOVE
        if (third.y == 0.0) {
            float level = level_of(hit.right.xy * third.z, hit.down.xy * third.z);
#ifdef WITH_TILES
            vec4 tiles = third.w > 0.0 ? texelFetch(surfaces, block) : vec4(0.0);
            vec4 far = third.w > 0.0 ? texelFetch(surfaces, block + 1) : vec4(0.0);
            vec4 mean = texelFetch(surfaces, block + 2);
            vec4 places = texelFetch(surfaces, block + 6);
#endif
#ifdef WITH_CELLS
            if (tiles.x > 0.0) {
                Cell cells[3] = cells_at(in_lattice(hit.position.xy, tiles.x) + places.xy, tiles);
                paint = min(mix_cells(cells, third.x, level, mean), 1.0);
                float metal = texelFetch(surfaces, block + 4).x;
                relief = mix_normals(cells, third.x + 1.0, level, metal);
#ifdef WITH_THIRD
                if (tiles.w > 0.0)
                    more = mix_cells(cells, third.x + tiles.w, level,
                                     texelFetch(surfaces, block + 3));
#endif
            } else
#endif
            {
                paint = textureLod(maps, vec3(at.xy, third.x), level);
                relief = textureLod(maps, vec3(at.xy, third.x + 1.0), level);
#ifdef WITH_THIRD
                more = textureLod(maps, vec3(at.xy, third.x + layer), level);
#endif
            }
#ifdef WITH_FAR
            if (far.x > 0.0) {
                float coarse = level + log2(far.x);
                vec4 wide = vec4(0.0);
#ifdef WITH_CELLS
                if (tiles.x > 0.0) {
                    vec2 spot = in_lattice(hit.position.xy, tiles.x * far.x) + places.zw;
                    wide = min(mix_cells(cells_at(spot, tiles), third.x, coarse, mean), 1.0);
                } else
#endif
                {
                    vec2 spot = hit.position.xy * (third.z * far.x)
                        + texelFetch(surfaces, block + 7).xy;
                    wide = textureLod(maps, vec3(spot, third.x), coarse);
                }
                // Where a channel is black everywhere it is so at any scale.
                vec3 relative = mix(vec3(1.0), wide.rgb / max(mean.rgb, 1e-12),
                                    greaterThan(mean.rgb, vec3(0.0)));
                paint.rgb *= 1.0 + far.y * (relative - 1.0);
            }
#endif
            vec3 t = vec3(hit.normal.z, 0.0, -hit.normal.x);
            t *= inversesqrt(max(dot(t, t), 1e-30));
            n = normalize(relief.x * t + relief.y * cross(hit.normal, t) + relief.z * n);
        }
#endif
#ifdef WITH_TRIPLANAR
        if (third.y == 1.0) {
            vec3 shares = hit.normal * hit.normal;
            shares *= shares;
            shares /= shares.x + shares.y + shares.z;
            vec3 leaned = vec3(0.0);
            paint = vec4(0.0);
#ifdef WITH_THIRD
            vec4 wide_more = vec4(0.0);
#endif
            for (int axis = 0; axis < 3; axis++) {
                vec3 place = vec3(on_plane(at, axis), third.x);
                float level = level_of(on_plane(hit.right, axis) * third.z,
                                       on_plane(hit.down, axis) * third.z);
                paint += shares[axis] * textureLod(maps, place, level);
                vec4 own = textureLod(maps, place + vec3(0.0, 0.0, 1.0), level);
                relief.a += shares[axis] * own.a;
#ifdef WITH_THIRD
                wide_more += shares[axis]
                    * textureLod(maps, place + vec3(0.0, 0.0, layer), level);
#endif
                // Whiteout blend, Golus 2017.
                vec3 add = axis == 0 ? vec3(0.0, own.xy) : axis == 1 ? vec3(own.x, 0.0, own.y)
                                                                     : vec3(own.xy, 0.0);
                vec3 scale = vec3(1.0);
                scale[axis] = own.z;
                leaned += shares[axis] * (hit.normal * scale + add);
            }
#ifdef WITH_THIRD
            more = wide_more;
#endif
            leaned = normalize(leaned);
            // From behind it is mirrored in the surface.
            n = side < 0.0 ? leaned - 2.0 * dot(leaned, hit.normal) * hit.normal : leaned;
        }
#endif
#ifdef WITH_UV
        if (third.y == 2.0) {
            float level = level_of(hit.uv_right, hit.uv_down);
            paint = textureLod(maps, vec3(hit.uv, third.x), level);
            relief = textureLod(maps, vec3(hit.uv, third.x + 1.0), level);
#ifdef WITH_THIRD
            more = textureLod(maps, vec3(hit.uv, third.x + layer), level);
#endif
            vec3 t = hit.along_u - dot(hit.along_u, hit.normal) * hit.normal;
            if (dot(t, t) > 0.0) {
                t = normalize(t);
                vec3 b = cross(hit.normal, t);
                b *= sign(dot(b, hit.along_v));
                n = normalize(relief.x * t + relief.y * b + relief.z * n);
            }
        }
#endif
        color *= paint.rgb;
        roughness = paint.a;
        metallic = relief.a;
    }
#endif
    color = min(color, 1.0);
#ifdef WITH_GLOSS
    roughness *= (1.0 + second.w * hit.variation) * (1.0 + second.w * hit.row);
    roughness = clamp(roughness, 0.0, 1.0);
#endif
    Look look;
    look.dull = (1.0 - metallic) * (1.0 - specular) * color;
    look.shine = vec3((1.0 - metallic) * specular) + metallic * color;
    look.roughness = roughness;
    look.normal = n;
#ifdef WITH_REFLECTANCE
    look.color = color;
    look.share = (1.0 - metallic) * (1.0 - specular);
    look.law = int(texelFetch(surfaces, 4 * index + 3).w) - 1;
#endif
#ifdef WITH_THIRD
    bool own = third.x >= 0.0 && third.w > 0.0 && texelFetch(surfaces, block).w > 0.0;
    if (!own)
        more = vec4(1.0, 1.0, 1.0, 0.5);
#endif
#ifdef WITH_HEIGHTS
    look.height = 0.5;
#ifdef WITH_THIRD
    look.height = min(more.a, 1.0);
#endif
#endif
#ifdef WITH_EMISSION
    int tile = int(texelFetch(surfaces, 4 * index + 2).w);
    look.glow = tile > 0 ? texelFetch(surfaces, tile + 5).rgb : vec3(0.0);
#ifdef WITH_THIRD
    look.glow *= more.rgb;
#endif
#endif
#ifdef WITH_MAPS
    // What points away from the viewer has its tangential part turned round; where the shading
    // normal itself leans away, the viewer counts as at its horizon.
    vec3 base = side * hit.normal;
    float height = dot(n, base);
    float seen = dot(n, hit.view) + height * max(1e-5 - dot(base, hit.view), 0.0);
    if (seen < 0.0)
        look.normal = 2.0 * height * base - n;
#endif
    return look;
}

vec3 light_of(Look look, vec3 view, float lit, Around around)
{
    float direct = lit * max(dot(look.normal, to_sun), 0.0);
    vec3 result = look.dull / PI * (direct * sun + irradiance_of(look.normal, around));
#ifdef WITH_REFLECTANCE
    if (look.law >= 0) {
        int first = LAW_ROWS * look.law;
        result = law_albedo(first, LAW_ROWS - 1, look.color, dot(look.normal, view)) / PI
            * irradiance_of(look.normal, around);
        if (direct > 0.0)
            result += law_value(first + LAW_ROWS - 1, look.color, look.normal, view) * direct * sun;
        result *= look.share;
    }
#endif
#ifdef WITH_GLOSS
    vec3 bright = sky_gloss(look.roughness, look.normal, view, around);
    if (direct > 0.0)
        bright += lit * sun * gloss(max(look.roughness * look.roughness, sun_alpha), look.normal,
                                    view, to_sun);
    // A normal that leans away from the viewer has no gloss, as in path tracers.
    if (dot(look.normal, view) > 0.0)
        result += look.shine * bright;
#endif
    return result;
}

vec3 shade(uvec2 id, vec3 direction, int number)
{
    Hit hit = find(id, direction);
    hit.number = number;
#ifdef WITH_LAMPS
    find_lamp(hit.position);
#endif
    float lit = sunlit(hit);
    Around around = around_of(hit);
    uvec4 mesh = texelFetch(meshes, 2 * int(hit.mesh));
    uvec4 more = texelFetch(meshes, 2 * int(hit.mesh) + 1);
    Look look = look_of(int(texelFetch(layers, int(more.x)).x), hit);
#ifdef WITH_MIXED
    vec3 result = light_of(look, hit.view, lit, around);
#endif
    for (int i = 1; i < int(more.y); i++) {
        ivec3 at = ivec3(hit.corner - mesh.x) + int(mesh.z) + (i - 1) * int(more.z);
        float weight = dot(hit.share, vec3(texelFetch(weights, at.x).x, texelFetch(weights, at.y).x,
                                           texelFetch(weights, at.z).x));
        Look over = look_of(int(texelFetch(layers, int(more.x) + i).x), hit);
#ifdef WITH_HEIGHTS
        // backends/heights.py is the same.
        int deep = int(mesh.z) + (int(more.y) - 1) * int(more.z) + i - 1;
        float depth = texelFetch(weights, deep).x;
        if (depth > 0.0) {
            depth = max(depth, 1e-3);
            float above = (2.0 * weight - 1.0) * (1.0 + depth) + over.height - look.height;
            weight = clamp(0.5 + above / (2.0 * depth), 0.0, 1.0);
        }
        look.height = mix(look.height, over.height, weight);
#endif
#ifdef WITH_EMISSION
        look.glow = mix(look.glow, over.glow, weight);
#endif
#ifdef WITH_MIXED
        result = mix(result, light_of(over, hit.view, lit, around), weight);
#else
        look.dull = mix(look.dull, over.dull, weight);
        look.shine = mix(look.shine, over.shine, weight);
#endif
    }
#ifndef WITH_MIXED
    vec3 result = light_of(look, hit.view, lit, around);
#endif
#ifdef WITH_EMISSION
    result += look.glow;
#endif
    return result;
}

void main()
{
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 sum = vec4(0.0);
    for (int y = 0; y < samples; y++)
        for (int x = 0; x < samples; x++) {
            ivec2 at = pixel * samples + ivec2(x, y);
            uvec2 id = texelFetch(ids, at, 0).xy;
            if (id.x == 0u)
                continue;
            vec3 direction = rays * vec3((vec2(at) + 0.5) / float(samples), 1.0);
            sum += vec4(shade(id, direction, 2 * y + x), 1.0);
        }
    light = sum / float(samples * samples);
}
