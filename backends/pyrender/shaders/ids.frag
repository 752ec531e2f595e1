#version 420 core
// What is seen: its slot, from 1, and its face; without WITH_IDS its depth alone.

#ifdef WITH_IDS
flat in int slot;

uniform int first_face;

layout(location = 0) out uvec2 id;
#endif

#ifdef WITH_CUTOUTS
in vec2 uv;

layout(binding = 15) uniform sampler2D field;  // See surface/cutouts.py.
uniform ivec3 cutout;              // Whether the mesh has one; its ways to wrap along u and v.

float folded(float x, int wrap, int texels)
{
    if (wrap == 0)
        return x;
    if (wrap == 2)
        x = 1.0 - abs(x - 2.0 * floor(x * 0.5) - 1.0);
    return clamp(x, 0.5 / texels, 1.0 - 0.5 / texels);
}

// Filters of hardware know places between texels to 1/256 alone.
bool is_cut()
{
    ivec2 size = textureSize(field, 0);
    vec2 at = vec2(folded(uv.x, cutout.y, size.x), folded(uv.y, cutout.z, size.y)) * size - 0.5;
    vec2 corner = floor(at), share = at - corner;
    ivec2 low = ivec2(corner - size * floor(corner / size));
    low = min(max(low, 0), size - 1);
    ivec2 high = (low + 1) % size;
    vec2 below = vec2(texelFetch(field, low, 0).r, texelFetch(field, ivec2(high.x, low.y), 0).r);
    vec2 above = vec2(texelFetch(field, ivec2(low.x, high.y), 0).r, texelFetch(field, high, 0).r);
    vec2 side = mix(below, above, share.y);
    return mix(side.x, side.y, share.x) <= 0.0;
}
#endif

void main()
{
#ifdef WITH_CUTOUTS
    if (cutout.x != 0 && is_cut())
        discard;
#endif
#ifdef WITH_IDS
    id = uvec2(slot + 1, first_face + gl_PrimitiveID);
#endif
}
