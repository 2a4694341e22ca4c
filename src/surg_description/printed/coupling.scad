// Coupling of a servo with the cable of one joint: a disc on the servo's horn, and a drum with a
// groove. Frame: z along the servo's axis. Lengths in mm. Print one for each servo, disc down.
//
// 'gear' is that of the motor in drive_<arm>.yaml: turns of the servo for one turn of the pulley in
// the instrument. Measure the circle of screws on your horn first.

gear = 1.0;
pulley = 5;          // radius that the cable turns in the instrument
cable = 0.6;         // diameter
turns = 3;           // of the cable on the drum
disc = 22;           // diameter
disc_height = 3;
horn_circle = 16;    // diameter; assumed
horn_screws = 4;
horn_screw = 2.3;    // through hole of an M2; assumed
screw_head = 4.2;
horn_boss = 6;       // room for the screw in the horn's middle
end = 0.8;           // hole in which the cable is knotted

drum = pulley / gear - cable / 2;  // radius of the groove's ground; the cable's middle counts
height = 2 * cable * turns;
assert(drum >= horn_boss / 2 + 1.2, "the drum is too thin: a larger pulley or a smaller gear");
assert(drum + cable <= (horn_circle - screw_head) / 2, "the drum covers the horn's screws");

$fn = 48;

difference() {
  union() {
    cylinder(d = disc, h = disc_height);
    translate([0, 0, disc_height]) cylinder(r = drum, h = height);
    translate([0, 0, disc_height + height]) cylinder(r = drum + cable, h = 1);
  }
  translate([0, 0, -1]) cylinder(d = horn_boss, h = disc_height + height + 3);
  for (k = [0:horn_screws - 1]) rotate(360 / horn_screws * k)
    translate([horn_circle / 2, 0, -1]) cylinder(d = horn_screw, h = disc_height + 2);
  translate([0, 0, disc_height + height / 2]) rotate([90, 0, 45])
    cylinder(d = end, h = disc, center = true);
}
