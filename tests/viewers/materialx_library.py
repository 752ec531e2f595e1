"""What a real MaterialX library, that out of bpy's bundled USD, says of nodes and networks.

Runs in a process of its own: ``materialx_library.py STAGE OUT.json NODE ...``.
"""

import json
import sys
from pathlib import Path

import bpy

bpy.utils.expose_bundled_modules()

import MaterialX  # noqa: E402
import MaterialX.PyMaterialXGenShader as Shader  # noqa: E402 - the next ones need it loaded
from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenMsl  # noqa: E402
from pxr import Sdr, Usd, UsdShade  # noqa: E402

ROOT = MaterialX.FileSearchPath(str(Path(MaterialX.__file__).parent))
GENERATORS = {
    "GLSL": PyMaterialXGenGlsl.GlslShaderGenerator,
    "ESSL": PyMaterialXGenGlsl.EsslShaderGenerator,
    "Vulkan": PyMaterialXGenGlsl.VkShaderGenerator,
    "MSL": PyMaterialXGenMsl.MslShaderGenerator,
}
#: Languages that the library brings node implementations for.
TARGETS = ("genglsl", "genmsl", "genosl", "genmdl")


def library():
    """A document with all node definitions."""
    document = MaterialX.createDocument()
    MaterialX.loadLibraries(MaterialX.getDefaultDataLibraryFolders(), ROOT, document)
    return document


def described(node_id, definitions):
    """Inputs and output of a node with their USD types, and languages it can be written in."""
    node = Sdr.Registry().GetShaderNodeByIdentifier(node_id)
    definition = definitions.getNodeDef(node_id)
    if not node or not definition:
        return None
    inputs = {name: node.GetShaderInput(name) for name in node.GetShaderInputNames()}
    outputs = {name: node.GetShaderOutput(name) for name in node.GetShaderOutputNames()}

    def types(plugs):
        return {n: str(p.GetTypeAsSdfType().GetSdfType()) for n, p in plugs.items()}

    targets = [target for target in TARGETS if definition.getImplementation(target)]
    return {"inputs": types(inputs), "outputs": types(outputs), "targets": targets}


def network(material, definitions):
    """The network of a Material as a MaterialX document, and its surface."""
    document = MaterialX.createDocument()
    document.importLibrary(definitions)
    shaders = [UsdShade.Shader(p) for p in material.GetPrim().GetChildren() if p.IsA("Shader")]
    shaders = [s for s in shaders if s.GetShaderId().startswith("ND_")]
    nodes = {}
    for shader in shaders:
        definition = document.getNodeDef(shader.GetShaderId())
        node = document.addNodeInstance(definition, shader.GetPrim().GetName())
        node.setNodeDefString(shader.GetShaderId())
        nodes[shader.GetPath()] = node
    for shader in shaders:
        node = nodes[shader.GetPath()]
        for plug in shader.GetInputs():
            made = node.addInputFromNodeDef(plug.GetBaseName())
            sources = plug.GetConnectedSources()[0]
            if sources:
                made.setConnectedNode(nodes[sources[0].source.GetPath()])
                made.removeAttribute("value")
            else:
                value = plug.Get()
                value = getattr(value, "path", value)
                text = str(tuple(value)).strip("()") if hasattr(value, "__len__") else str(value)
                made.setValueString(value if isinstance(value, str) else text)
    surface = material.ComputeSurfaceSource("mtlx")[0]
    return document, nodes[surface.GetPath()]


def checked(material, definitions):
    """Whether a network is valid, why not, and how much shader code generators make of it."""
    document, surface = network(material, definitions)
    document.addMaterialNode("made", surface)
    valid, message = document.validate()
    sizes = {}
    for name, kind in GENERATORS.items():
        generator = kind.create()
        context = Shader.GenContext(generator)
        context.registerSourceCodeSearchPath(ROOT)
        shader = generator.generate("shader", surface, context)
        sizes[name] = len(shader.getSourceCode(Shader.PIXEL_STAGE))
    return {"valid": valid, "message": message, "nodes": len(document.getNodes()), "code": sizes}


def main():
    """Writes the answers."""
    path, out, *node_ids = sys.argv[1:]
    definitions = library()
    stage = Usd.Stage.Open(path)
    materials = [UsdShade.Material(p) for p in stage.Traverse() if p.IsA("Material")]
    answer = {
        "nodes": {node_id: described(node_id, definitions) for node_id in node_ids},
        "networks": {str(m.GetPath()): checked(m, definitions) for m in materials},
    }
    Path(out).write_text(json.dumps(answer), encoding="utf-8")


main()
