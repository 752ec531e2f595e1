#version 420 core
// Depth alone.

void main()
{
}
