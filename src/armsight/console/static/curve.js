import { THREE } from "nicegui-scene";

/* A curve that is seen whole: through what stands before it, in one thickness from near and far, and wherever its first
   point is. line: solid, dashed or none; its marks are dots of mark_px, none for 0. */
export default class Curve {
  mesh;

  create_mesh(points, colours, line, mark_px, dash_m, layer) {
    const always = { vertexColors: true, transparent: true, depthTest: false, depthWrite: false };
    const dashes = { ...always, dashSize: dash_m, gapSize: 0.6 * dash_m };
    const drawn = line === "dashed" ? new THREE.LineDashedMaterial(dashes) : new THREE.LineBasicMaterial(always);
    const dots = new THREE.PointsMaterial({ ...always, size: mark_px, sizeAttenuation: false });
    this.geometry = new THREE.BufferGeometry();
    this.line = new THREE.Line(this.geometry, drawn);
    this.marks = new THREE.Points(this.geometry, dots);
    this.line.visible = line !== "none";
    this.marks.visible = mark_px > 0;
    this.mesh = new THREE.Group();
    for (const part of [this.line, this.marks]) {
      part.renderOrder = layer;
      part.raycast = () => {}; // clicks are for the places under it
      this.mesh.add(part);
    }
    this.set_points(points, colours);
    return this.mesh;
  }

  set_points(points, colours) {
    this.geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
    const linear = colours.flatMap(([r, g, b]) => new THREE.Color().setRGB(r, g, b, THREE.SRGBColorSpace).toArray());
    this.geometry.setAttribute("color", new THREE.Float32BufferAttribute(linear, 3));
    this.geometry.boundingSphere = null; // of the points before: what is out of sight by it is not drawn
    this.geometry.boundingBox = null;
    if (this.line.material.isLineDashedMaterial) this.line.computeLineDistances();
  }
}
