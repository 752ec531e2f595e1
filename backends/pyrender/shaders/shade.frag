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
uniform vec3 to_sun;
uniform vec3 sun;                  // Irradiance facing it.
uniform float sun_alpha;           // Least alpha of a lobe that shows it: its disc's width.
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
    float up = dot(hit.normal, hit.view) < 0.0 ? -hit.normal.z : hit.normal.z;
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
        vec3 lifted = hit.position + hit.flat_normal * (shadow_texel[c].x * 1.5 * turn);
        vec3 p = (shadow_clip[c] * vec4(lifted, 1.0)).xyz;
        p.xy = 0.5 * p.xy + 0.5;
        bool inside = c < cascades && all(greaterThanEqual(p, vec3(0.0)))
            && all(lessThanEqual(p, vec3(1.0)));
        if (inside && !found)
            place = vec4(p.xy, float(c), p.z + shadow_texel[c].y);
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
    return slope <= 0.0 ? 0.0 : found ? lit / float(places) : 1.0;
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
};

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
    float side = dot(hit.normal, hit.view) < 0.0 ? -1.0 : 1.0;
    vec3 n = side * hit.normal;
#ifdef WITH_MAPS
    vec4 third = texelFetch(surfaces, 4 * index + 2);
    if (third.x >= 0.0) {
        vec3 at = hit.position * third.z + texelFetch(surfaces, 4 * index + 3).xyz;
        vec4 paint = vec4(1.0);
        vec4 relief = vec4(0.0);
#ifdef WITH_ABOVE
        if (third.y == 0.0) {
            float level = level_of(hit.right.xy * third.z, hit.down.xy * third.z);
            paint = textureLod(maps, vec3(at.xy, third.x), level);
            relief = textureLod(maps, vec3(at.xy, third.x + 1.0), level);
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
            for (int axis = 0; axis < 3; axis++) {
                vec3 place = vec3(on_plane(at, axis), third.x);
                float level = level_of(on_plane(hit.right, axis) * third.z,
                                       on_plane(hit.down, axis) * third.z);
                paint += shares[axis] * textureLod(maps, place, level);
                vec4 own = textureLod(maps, place + vec3(0.0, 0.0, 1.0), level);
                relief.a += shares[axis] * own.a;
                // Whiteout blend, Golus 2017.
                vec3 add = axis == 0 ? vec3(0.0, own.xy) : axis == 1 ? vec3(own.x, 0.0, own.y)
                                                                     : vec3(own.xy, 0.0);
                vec3 scale = vec3(1.0);
                scale[axis] = own.z;
                leaned += shares[axis] * (hit.normal * scale + add);
            }
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
    return look;
}

vec3 light_of(Look look, vec3 view, float lit, Around around)
{
    float direct = lit * max(dot(look.normal, to_sun), 0.0);
    vec3 result = look.dull / PI * (direct * sun + irradiance_of(look.normal, around));
#ifdef WITH_GLOSS
    vec3 bright = sky_gloss(look.roughness, look.normal, view, around);
    if (direct > 0.0)
        bright += lit * sun * gloss(max(look.roughness * look.roughness, sun_alpha), look.normal,
                                    view, to_sun);
    result += look.shine * bright;
#endif
    // From behind a normal that leans away there is nothing to see, as in path tracers.
    return dot(look.normal, view) > 0.0 ? result : vec3(0.0);
}

vec3 shade(uvec2 id, vec3 direction, int number)
{
    Hit hit = find(id, direction);
    hit.number = number;
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
#ifdef WITH_MIXED
        result = mix(result, light_of(over, hit.view, lit, around), weight);
#else
        look.dull = mix(look.dull, over.dull, weight);
        look.shine = mix(look.shine, over.shine, weight);
#endif
    }
#ifdef WITH_MIXED
    return result;
#else
    return light_of(look, hit.view, lit, around);
#endif
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
