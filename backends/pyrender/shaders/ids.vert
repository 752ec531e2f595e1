#version 420 core
// Positions to clip space, by the pose of the slot.

layout(location = 0) in vec3 position;

layout(binding = 1) uniform samplerBuffer poses;  // Four texels a slot, see geometry.Selection.
uniform mat4 clip;
uniform int first_slot;

flat out int slot;

#ifdef WITH_CUTOUTS
layout(location = 1) in vec2 coordinates;

out vec2 uv;
#endif

void main()
{
    slot = first_slot + gl_InstanceID;
#ifdef WITH_CUTOUTS
    uv = coordinates;
#endif
    vec4 p = vec4(position, 1.0);
    gl_Position = clip * vec4(
        dot(texelFetch(poses, 4 * slot), p),
        dot(texelFetch(poses, 4 * slot + 1), p),
        dot(texelFetch(poses, 4 * slot + 2), p),
        1.0
    );
}
