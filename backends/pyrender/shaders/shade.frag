#version 420 core
// The light of a point (see points.py), shaded by the shared surface model.
//
// f = (1-m) * ((1-s) * Lambert(c) + s * GGX(white)) + m * GGX(c), layers mixed from the base up; of
// Lambert's lobe a share goes through sheets.
// All positions are relative to the camera; axes are the world's.

const float PI = 3.14159265358979;

layout(binding = 0) uniform usampler2D points;         // See points.py; 0 is nothing.
layout(binding = 1) uniform samplerBuffer poses;       // Four texels a slot: a 3x4 matrix, then (mesh, variation).
layout(binding = 2) uniform usamplerBuffer faces;      // Vertex indices within the mesh.
layout(binding = 3) uniform samplerBuffer vertices;    // Position and variation.
layout(binding = 4) uniform samplerBuffer normals;     // Shading normals; unused where a mesh has none.
layout(binding = 5) uniform samplerBuffer weights;     // Merge by merge, of all vertices of a mesh.
layout(binding = 6) uniform usamplerBuffer meshes;     // Two texels a mesh, see tables.py.
layout(binding = 7) uniform usamplerBuffer layers;     // Surfaces of the meshes.
layout(binding = 8) uniform samplerBuffer surfaces;    // Four texels a surface, see tables.py.
layout(binding = 10) uniform sampler2DArray maps;
layout(binding = 11) uniform sampler2DArrayShadow shadows;
layout(binding = 16) uniform sampler2D depth;          // Of each sample.

layout(binding = 14) uniform samplerBuffer uvs;        // Two texels a face: its corners' coordinates; three: colors.
#ifdef WITH_REFLECTANCE
layout(binding = 9) uniform sampler2D laws;          // See laws.py.
#endif
#ifdef WITH_GROUND
layout(binding = 12) uniform sampler2D ground_sky;    // Share of the sky, and of ground above.
layout(binding = 13) uniform sampler2D ground_light;  // Radiance of the ground about.
uniform float ground_share;          // 0 leaves its light out.
uniform vec4 ground_place;         // From x and y to their coordinates: scale, then offset.
#endif
#ifdef WITH_CANOPY
layout(binding = 17) uniform sampler3D canopy;  // What leaves leave of the light from all around.
uniform vec3 canopy_scale;         // From positions to its coordinates.
uniform vec3 canopy_offset;
uniform float canopy_reach;        // How far beside it leaves hide some of the sky, meters.
#endif
#ifdef WITH_FACETS
uniform float aureole;             // Share of the light from all around that comes from about the sun.
#endif
uniform int samples;               // Per side of a pixel.
uniform float near;                // Over depth it is the planar distance.
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
#ifdef WITH_GOBO
layout(binding = 15) uniform sampler2D gobo;  // Share of the sun's light that comes through.
uniform vec4 gobo_u;               // From places to coordinates in it.
uniform vec4 gobo_v;
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
#ifdef WITH_COLORS
    vec3 color;        // Of the corners.
#endif
    float variation;   // Of the vertices,
    float row;         // and of the row.
    vec3 right;        // Edges on the face of what it stands for,
    vec3 down;         // meters.
    ivec2 pixel;
    uint mask;         // Its samples, a bit each.
#ifdef WITH_UV
    vec2 uv;
    vec2 uv_right;     // The edges in the picture.
    vec2 uv_down;
    vec3 along_u;      // dP/du and dP/dv, of any length.
    vec3 along_v;
#endif
};

// What a surface's numbers and its base color's map make of it.
struct Lobes {
    vec3 color;
    float alpha;
    float dull;     // Weight of Lambert's lobe or of a law in its place.
    vec3 gloss;     // What a white lobe that scatters once is multiplied with.
#ifdef WITH_THROUGH
    float through;  // Weight of Lambert's lobe on the far side.
#endif
};

// What maps hold at a hit.
struct Pictured {
    vec3 base_color;
    float roughness;
    vec3 normal;    // Leaned, where it points outward.
    float metallic;
    vec3 emission;
    float height;
};

// How the maps of a surface lie.
struct Lie {
    float step;     // Repeats in a meter,
    vec3 start;     // and where the camera lies in them.
    float layer;    // In the maps: color and roughness, then normal and metallic;
    float third;    // emission and height.
    float levels[3];  // By the axis that they are seen along.
    float side;     // Of cells: sides of the lattice in a meter,
    float repeats;  // repeats along one,
    vec2 corner;    // where the camera lies,
    int table;      // and their texels.
    vec4 means[3];  // Of the layers.
    vec3 gain;      // Of colors' second scale.
    vec3 rest;
};

SURFACE_FUNCTIONS

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

Hit find(uvec2 id, vec3 direction, vec2 extent)
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
    vec3 dx = rays[0] * extent.x;
    vec3 dy = rays[1] * extent.y;
    float along = dot(outward, direction);
    float t = dot(hit.position, direction) / dot(direction, direction);
    hit.right = t * (dx - direction * (dot(outward, dx) / along));
    hit.down = t * (dy - direction * (dot(outward, dy) / along));
#ifdef WITH_UV
    // 0 in the table: the mesh has no coordinates, and all its corners are at (0, 0).
    int first_uv = int(texelFetch(meshes, 2 * int(hit.mesh) + 1).w);
    find_uv(hit, first_uv == 0 ? 0 : first_uv + int(id.y), ab, ac);
#endif
#ifdef WITH_COLORS
    int color = int(mesh.w >> 1u) + 3 * int(id.y);
    hit.color = mesh.w < 2u ? vec3(1.0)
        : hit.share.x * texelFetch(uvs, color).xyz + hit.share.y * texelFetch(uvs, color + 1).xyz
            + hit.share.z * texelFetch(uvs, color + 2).xyz;
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

// Side 1 is the viewer's, -1 the far one.
Around around_of(Hit hit, float side)
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
    float up = dot(hit.normal, hit.flat_normal) * side < 0.0 ? -hit.normal.z : hit.normal.z;
    around.taken = share.a + 0.5 - 0.5 * up;
    around.ground = ground_share * texture(ground_light, place).rgb;
#endif
#ifdef WITH_CANOPY
    // Beside the lattice and above it all is open.
    vec3 inside = hit.position * canopy_scale + canopy_offset;
    vec2 beyond = max(abs(inside.xy - 0.5) - 0.5, 0.0) / (canopy_scale.xy * canopy_reach);
    float open = texture(canopy, inside).r;
    open = inside.z > 1.0 ? 1.0 : mix(open, 1.0, min(length(beyond), 1.0));
    around.share *= open;
    around.ground *= open;
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
// Share of a lamp's intensity on its axis that arrives at a place, by the square of the distance.
float of_lamp(vec3 at)
{
    vec3 way = lamp_position - at;
    float squared = max(dot(way, way), 1e-20);
    return squared > lamp_cone.w * lamp_cone.w
        ? lamp_falloff(-way * inversesqrt(squared), lamp_axis, lamp_cone.xyz) / squared : 0.0;
}

void find_lamp(vec3 at)
{
    vec3 way = lamp_position - at;
    float squared = max(dot(way, way), 1e-20);
    to_sun = way * inversesqrt(squared);
    // What arrives is ``sunlit``, which knows the places of all samples.
    sun = lamp;
    sun_alpha = max(least_alpha, 0.5 * lamp_cone.w * inversesqrt(squared));
}
#endif

// Where a place lies in a shadow map: from 0 to 1 inside of it.
vec3 in_shadow_map(vec3 place, int layer)
{
    vec4 clip = shadow_clip[layer] * vec4(place, 1.0);
#ifdef WITH_LAMPS
    vec3 p = clip.w > 0.0 ? clip.xyz / clip.w : vec3(-2.0);
#else
    vec3 p = clip.xyz;
#endif
    return vec3(0.5 * p.xy + 0.5, p.z);
}

// How far along its normal a surface is raised: none shades itself by what a texel is wide.
float lift(Hit hit, vec3 position, int layer, float turn)
{
#ifdef WITH_LAMPS
    // Texels lie across the map's axis and grow along it; depth is the inverse.
    mat4 m = shadow_clip[layer];
    float along = dot(hit.flat_normal, vec3(m[0][3], m[1][3], m[2][3]));
    float apart = max((m * vec4(position, 1.0)).w, 0.0);
    turn = apart * sqrt(max(1.0 - along * along, 0.0));
#endif
    return shadow_texel[layer].x * 1.5 * turn;
}

// The place of a sample.
vec3 seen_at(ivec2 at)
{
    vec3 direction = rays * vec3((vec2(at) + 0.5) / float(samples), 1.0);
    return direction * (near / texelFetch(depth, at, 0).r);
}

// How much of the sun arrives at a hit: the finest shadow map that holds it, filtered. Below 0 it
// arrives on the far side.
float sunlit(Hit hit)
{
    float slope = dot(hit.flat_normal, to_sun);
    float side = 1.0;
#ifdef WITH_THROUGH
    if (slope < 0.0) {
        side = -1.0;
        slope = -slope;
        hit.flat_normal = -hit.flat_normal;
    }
#endif
    float turn = sqrt(max(1.0 - slope * slope, 0.0));
    float lit = 0.0;
    vec2 texel = 0.5 / vec2(textureSize(shadows, 0).xy);
    // At each of its samples, or four times in a pixel that is one.
    uint left = samples == 1 ? 15u : hit.mask;
    float taps = float(bitCount(left));
    while (left != 0u) {
        int k = findLSB(left);
        left &= left - 1u;
        ivec2 at = samples == 1 ? ivec2(0) : ivec2(k % samples, k / samples);
        vec3 position = seen_at(hit.pixel * samples + at);
        // Looked up after the choice: software runs all of a loop's and a branch's instructions.
        vec4 place = vec4(0.0);
        bool found = false;
        for (int c = 0; c < CASCADES; c++) {
            vec3 raised = position + hit.flat_normal * lift(hit, position, c, turn);
            vec3 p = in_shadow_map(raised, c);
            bool inside = c < cascades && all(greaterThanEqual(p, vec3(0.0)))
                && all(lessThanEqual(p, vec3(1.0)));
            float bias = shadow_texel[c].y;
#ifdef WITH_LAMPS
            bias *= p.z;
#endif
            if (inside && !found)
                place = vec4(p.xy, float(c), p.z + bias);
            found = found || inside;
        }
        at = samples == 1 ? ivec2(k & 1, k >> 1) : at & 1;
        vec2 corner = vec2(at) * 2.0 - 1.0;
        float open = texture(shadows, vec4(place.xy + texel * corner, place.zw));
#ifdef WITH_LAMPS
        // What no map holds is lit in another pass, or not at all.
        open = found ? open * of_lamp(position) : 0.0;
#else
        // Beyond all maps nothing hides the sun.
        open = found ? open : 1.0;
#endif
#ifdef WITH_GOBO
        vec4 through = vec4(position, 1.0);
        open *= texture(gobo, vec2(dot(gobo_u, through), dot(gobo_v, through))).r;
#endif
        lit += open;
    }
    return slope <= 0.0 ? 0.0 : side * lit / taps;
}

// The sky in a lobe: its albedo times what spherical harmonics keep of the sky about the mirrored
// direction. A lobe of width alpha shrinks band l by exp(-(alpha l)**2) (Ramamoorthi and Hanrahan
// 2001).
vec3 sky_gloss(float alpha, vec3 n, vec3 v, Around around)
{
    float nv = max(dot(n, v), 1e-5);
    vec3 r = reflect(-v, n);
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
    return radiance * gloss_albedo(alpha, nv);
}

// A surface at a hit, or a mixture of several that share roughness and normal.
struct Look {
    vec3 dull;   // Albedo of the Lambert lobe,
    vec3 shine;  // and of the GGX lobe, by one that is white and scatters once.
    float alpha;
    vec3 normal;  // Towards the camera.
#ifdef WITH_FACETS
    vec3 facing;  // Of shading, without maps,
    float rough;  // and how its facets' slopes deviate; 0: they hide nothing of each other.
#endif
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
#ifdef WITH_THROUGH
    vec3 through;  // Albedo of the lobe on the far side.
#endif
};

#ifdef WITH_REFLECTANCE
// BRDF of a law for the light.
vec3 law_value(int row, vec3 r0, vec3 n, vec3 v, float mu)
{
    vec4 law = texelFetch(laws, ivec2(0, row), 0);
    vec2 more = texelFetch(laws, ivec2(1, row), 0).xy;
    vec3 apart = v - to_sun;
    vec3 both = v + to_sun;
    // tan(g / 2); a disc blurs it by a third of its radius, which sun_alpha is half of.
    float blur = 2.0 / 3.0 * sun_alpha;
    float t = sqrt(dot(apart, apart) / max(dot(both, both), 1e-6) + blur * blur);
    float mu0 = dot(n, to_sun);
    if (law.x == 0.0)
        return law_once(law, more, r0, mu0, mu, t);
    return more.y > 0.0 ? law_rough(law, more, r0, mu0, mu, t)
                        : law_smooth(law, more, r0, mu0, mu, t);
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
    // Several points show a pixel, so that each may show half of what would blur it alone.
    float share = samples > 1 ? 0.5 : 1.0;
    return log2(max(share * min(max(a, b), 4.0 * fine) * float(textureSize(maps, 0).x), 1e-6));
}

// The coordinates of a point or a vector on the plane across an axis.
vec2 on_plane(vec3 point, int axis)
{
    return axis == 0 ? point.yz : axis == 1 ? point.xz : point.xy;
}
#endif

#ifdef WITH_MAPS
// How the maps of a surface lie; block is 0 where it has none.
Lie lie_of(int index, vec4 third, Hit hit)
{
    Lie lie;
    int block = int(third.w);
    lie.step = third.z;
    lie.start = texelFetch(surfaces, 4 * index + 3).xyz;
    lie.layer = lie.third = third.x;
    for (int axis = 0; axis < 3; axis++)
        lie.levels[axis] = level_of(on_plane(hit.right, axis) * third.z,
                                    on_plane(hit.down, axis) * third.z);
#ifdef WITH_UV
    if (third.y == 2.0)
        lie.levels[2] = level_of(hit.uv_right, hit.uv_down);
#endif
    lie.side = 0.0;
#ifdef WITH_BLOCKS
    if (block > 0) {
        vec4 cells = texelFetch(surfaces, block);
        lie.side = cells.x;
        lie.repeats = cells.y;
        lie.table = int(cells.z);
        // Without a picture of its own it is looked up in another, and not used.
        lie.third += cells.w;
        lie.corner = texelFetch(surfaces, block + 7).xy;
        for (int k = 0; k < 3; k++)
            lie.means[k] = texelFetch(surfaces, block + 3 + k);
    }
#endif
    return lie;
}

Pictured pictured(int index, vec4 third, Hit hit)
{
    Lie lie = lie_of(index, third, hit);
    Pictured found;
#ifdef WITH_TRIPLANAR
    if (third.y == 1.0)
        return look_triplanar(hit, lie);
#endif
#ifdef WITH_UV
    if (third.y == 2.0)
        return look_uv(hit, lie);
#endif
#ifdef WITH_ABOVE
#ifdef WITH_CELLS
    if (lie.side > 0.0)
        found = look_cells(hit, lie);
    else
#endif
        found = look_above(hit, lie);
#ifdef WITH_FAR
    int block = int(third.w);
    vec4 gain = block > 0 ? texelFetch(surfaces, block + 1) : vec4(0.0);
    if (gain.a > 0.0) {
        vec4 places = texelFetch(surfaces, block + 7);
        lie.step *= gain.a;
        lie.side *= gain.a;
        lie.levels[2] += log2(gain.a);
        lie.corner = places.zw;
        lie.start = texelFetch(surfaces, block + 8).xyz;
        lie.gain = gain.rgb;
        lie.rest = texelFetch(surfaces, block + 2).rgb;
#ifdef WITH_CELLS
        if (lie.side > 0.0)
            found.base_color *= far_cells(hit, lie);
        else
#endif
            found.base_color *= far_above(hit, lie);
    }
#endif
#endif
    return found;
}
#endif

Look look_of(int index, Hit hit)
{
    vec4 first = texelFetch(surfaces, 4 * index);
    vec4 second = texelFetch(surfaces, 4 * index + 1);
    float side = dot(hit.normal, hit.flat_normal) < 0.0 ? -1.0 : 1.0;
    Look look;
    look.normal = side * hit.normal;
#ifdef WITH_FACETS
    look.facing = look.normal;
    int relief = int(texelFetch(surfaces, 4 * index + 2).w);
    look.rough = relief > 0 ? texelFetch(surfaces, relief + 5).y : 0.0;
#endif
    Pictured found;
    found.base_color = vec3(1.0);
    found.roughness = second.x;
    found.metallic = second.z;
#ifdef WITH_MAPS
    vec4 third = texelFetch(surfaces, 4 * index + 2);
    if (third.x >= 0.0) {
        found = pictured(index, third, hit);
#ifdef WITH_FACETS
        // Facets are seen where others are that face the viewer.
        look.normal = look.rough > 0.0 ? sided(found.normal, hit.normal, look.facing)
            : seen(found.normal, hit.normal, look.normal, hit.view);
#else
        look.normal = seen(found.normal, hit.normal, look.normal, hit.view);
#endif
    }
#endif
#ifdef WITH_COLORS
    found.base_color *= hit.color;
#endif
    float cosine = max(dot(look.normal, hit.view), 1e-5);
#ifdef WITH_THROUGH
    int sheet = int(texelFetch(surfaces, 4 * index + 2).w);
    float transmission = sheet > 0 ? texelFetch(surfaces, sheet + 6).a : 0.0;
    Lobes lobes = lobes_of(first, second, found, hit, cosine, transmission);
    look.through = lobes.through * lobes.color;
#else
    Lobes lobes = lobes_of(first, second, found, hit, cosine);
#endif
    look.dull = lobes.dull * lobes.color;
    look.shine = lobes.gloss;
    look.alpha = lobes.alpha;
#ifdef WITH_REFLECTANCE
    look.color = lobes.color;
    look.share = lobes.dull;
    look.law = int(texelFetch(surfaces, 4 * index + 3).w) - 1;
#endif
#ifdef WITH_BLOCKS
    int block = int(texelFetch(surfaces, 4 * index + 2).w);
#ifdef WITH_HEIGHTS
    look.height = 0.5;
#endif
#ifdef WITH_EMISSION
    look.glow = block > 0 ? texelFetch(surfaces, block + 6).rgb : vec3(0.0);
#endif
#ifdef WITH_THIRD
    if (block > 0 && texelFetch(surfaces, block).w > 0.0) {
#ifdef WITH_HEIGHTS
        look.height = min(found.height, 1.0);
#endif
#ifdef WITH_EMISSION
        look.glow *= found.emission;
#endif
    }
#endif
#endif
    return look;
}

vec3 light_of(Look look, vec3 view, float lit, Around around)
{
    float direct = max(lit, 0.0) * max(dot(look.normal, to_sun), 0.0);
    vec3 ambient = irradiance_of(look.normal, around);
    float cosine = dot(look.normal, view);
#ifdef WITH_FACETS
    if (look.rough > 0.0) {
        cosine = dot(look.facing, view);
        float share = facets(look.rough, cosine, dot(look.facing, to_sun), dot(view, to_sun));
        direct *= share;
        ambient *= mix(facets_even(look.rough, cosine), share, aureole);
    }
#endif
    vec3 result = look.dull / PI * (direct * sun + ambient);
#ifdef WITH_REFLECTANCE
    if (look.law >= 0) {
        int first = LAW_ROWS * look.law;
        result = law_albedo(first, LAW_ROWS - 1, look.color, cosine) / PI * ambient;
        if (direct > 0.0)
            result += law_value(first + LAW_ROWS - 1, look.color, look.normal, view, cosine)
                * direct * sun;
        result *= look.share;
    }
#endif
#ifdef WITH_GLOSS
    vec3 bright = sky_gloss(look.alpha, look.normal, view, around);
    if (direct > 0.0)
        bright += lit * sun * gloss(max(look.alpha, sun_alpha), look.normal, view, to_sun);
    // A normal that leans away from the viewer has no gloss, as in path tracers.
    if (dot(look.normal, view) > 0.0)
        result += look.shine * bright;
#endif
    return result;
}

#ifdef WITH_THROUGH
// What arrives on the far side and passes.
vec3 passed(Look look, float lit, Around beyond)
{
    float direct = max(-lit, 0.0) * max(-dot(look.normal, to_sun), 0.0);
    return look.through / PI * (direct * sun + irradiance_of(-look.normal, beyond));
}
#endif

vec3 shade(uvec4 point)
{
    ivec2 pixel = ivec2(point.z & 0xffffu, point.z >> 16);
    uint mask = point.w & 0xffffu;
    vec2 middle = vec2(pixel) + vec2((point.w >> 16) & 255u, point.w >> 24) / 256.0;
    // Columns and rows that it has samples in.
    uint columns = 0u;
    uint lines = 0u;
    for (int k = 0; k < samples; k++) {
        uint line = mask >> (k * samples) & ((1u << samples) - 1u);
        columns |= line;
        lines += line != 0u ? 1u : 0u;
    }
    vec2 extent = vec2(bitCount(columns), lines) / float(samples);
    Hit hit = find(uvec2(point.x, point.y), rays * vec3(middle, 1.0), extent);
    hit.pixel = pixel;
    hit.mask = mask;
#ifdef WITH_LAMPS
    find_lamp(hit.position);
#endif
    float lit = sunlit(hit);
    Around around = around_of(hit, 1.0);
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
        int deep = int(mesh.z) + (int(more.y) - 1) * int(more.z) + i - 1;
        float depth = texelFetch(weights, deep).x;
        if (depth > 0.0)
            weight = heeded(weight, depth, look.height, over.height);
        look.height = mix(look.height, over.height, weight);
#endif
#ifdef WITH_EMISSION
        look.glow = mix(look.glow, over.glow, weight);
#endif
#ifdef WITH_THROUGH
        look.through = mix(look.through, over.through, weight);
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
#ifdef WITH_THROUGH
    if (any(greaterThan(look.through, vec3(0.0))))
        result += passed(look, lit, around_of(hit, -1.0));
#endif
    return result;
}

void main()
{
    uvec4 point = texelFetch(points, ivec2(gl_FragCoord.xy), 0);
    light = point.x == 0u ? vec4(0.0) : vec4(shade(point), 1.0);
}
