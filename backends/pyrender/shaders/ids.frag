#version 420 core
// What is seen: its slot, from 1, and its face.

flat in int slot;

uniform int first_face;

layout(location = 0) out uvec2 id;

void main()
{
    id = uvec2(slot + 1, first_face + gl_PrimitiveID);
}
