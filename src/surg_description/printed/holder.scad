// Holder of the instrument: a plate on the robot's flange, a beam to the side and a tube that clamps
// the shaft, or in which it turns. Frame: the flange's, z outwards; x points to the shaft. Lengths in
// mm. Print it plate down, without supports.
//
// The offset is measured, not trusted: with a straight rod of the shaft's diameter in the tube,
// measure from the flat on the plate's back to the far side of the rod. What is missing to
// 'reading' is missing in the offset: state it in the URDF, joint wrist_roll.

offset = 60;         // from the flange's axis to the shaft's
shaft = 8;           // diameter
fit = 0.2;           // that the bore is wider
plate_radius = 31.5;
plate = 12;          // thickness
flat = 28;           // from the flange's axis to the flat on the plate's back
bolt_circle = 50;    // ISO 9409-1-50-4-M6: diameter, and four holes
bolt = 6.6;          // through hole of an M6
bolt_head = 11;      // room for its head
beam = [26, 12];     // width, and height from 'beam_at'
beam_at = 6;
tube_radius = 14;
tube = 30;           // length
slit = 2;
clamp = 3.4;         // through hole of an M3
clamp_at = [9, 22];  // of its axis: from the shaft's axis, and height

reading = flat + offset + shaft / 2;
echo(reading = reading);

$fn = 48;

module body() {
  intersection() {
    cylinder(r = plate_radius, h = plate);
    translate([-flat, -plate_radius, 0]) cube([flat + plate_radius, 2 * plate_radius, plate]);
  }
  translate([0, -beam[0] / 2, beam_at]) cube([offset, beam[0], beam[1]]);
  translate([offset, 0, 0]) cylinder(r = tube_radius, h = tube);
}

difference() {
  body();
  for (k = [0:3]) rotate(45 + 90 * k) translate([bolt_circle / 2, 0, -1]) {
    cylinder(d = bolt, h = tube);
    translate([0, 0, plate - 5]) cylinder(d = bolt_head, h = tube);
  }
  translate([offset, 0, -1]) {
    cylinder(d = shaft + fit, h = tube + 2);
    translate([0, -slit / 2, 0]) cube([tube_radius + 1, slit, tube + 2]);
  }
  translate([offset + clamp_at[0], -tube_radius, clamp_at[1]])
    rotate([-90, 0, 0]) cylinder(d = clamp, h = 2 * tube_radius);
}
