#include <string>

#include "convert.hpp"
#include "surg_core/config_keys.hpp"

namespace surg::python {
namespace {

using config::kParts;
using config::kShapes;
using config::kSides;

template <typename Enum, std::size_t n>
void choose(const std::string& text, const std::array<const char*, n>& words, const char* key,
            Enum& value) {
  std::string allowed;
  for (const char* word : words)
    allowed += (allowed.empty() ? "'" : ", '") + std::string(word) + "'";
  const auto found = config::word_to<Enum>(text, words);
  if (found) {
    value = *found;
  } else {
    throw py::value_error(std::string(key) + ": '" + text + "' is not known; allowed: " + allowed);
  }
}

Fixture make_fixture(const std::string& name, const std::string& shape, const std::string& side,
                     const std::string& of, const Array& point, const Array& axis, double radius) {
  Fixture f;
  f.set_name(name);
  choose(shape, kShapes, "shape", f.shape);
  choose(side, kSides, "side", f.side);
  choose(of, kParts, "of", f.of);
  f.point = to_vector3(point, "point");
  f.axis = to_vector3(axis, "axis");
  f.radius = radius;
  const std::string problem = check_fixture(f);
  if (!problem.empty()) throw py::value_error("fixture " + name + ": " + problem);
  return f;
}

}  // namespace

void bind_fixtures(py::module_& m) {
  py::class_<Fixture>(m, "Fixture", "A virtual fixture: a region in the robot's base frame.")
      .def(
          py::init(&make_fixture), py::arg("name"), py::arg("shape"), py::arg("side"),
          py::arg("of"), py::arg("point"), py::arg("axis"), py::arg("radius") = 0.0,
          "shape: 'plane', 'sphere' or 'capsule'; side: 'keep_out' or 'stay_in'; of: 'tip' or\n"
          "'shaft'; axis (3,): a plane's unit normal into the region, or the way [m] from 'point'\n"
          "to a capsule's other end. Raises ValueError.")
      .def_property_readonly("name", [](const Fixture& f) { return std::string(f.title()); })
      .def_property_readonly("shape",
                             [](const Fixture& f) { return config::word_of(f.shape, kShapes); })
      .def_property_readonly("side",
                             [](const Fixture& f) { return config::word_of(f.side, kSides); })
      .def_property_readonly("of", [](const Fixture& f) { return config::word_of(f.of, kParts); })
      .def_readonly("of_cell", &Fixture::of_cell, "Stated by the cell.")
      .def_property_readonly("point", array_of(&Fixture::point), "[m] (3,)")
      .def_property_readonly("axis", array_of(&Fixture::axis), "(3,)")
      .def_readonly("radius", &Fixture::radius, "[m]")
      .def(
          "distance",
          [](const Fixture& f, const Array& p_Tip, const Array& p_Rcm) {
            Fixture at = f;
            const Vector3 origin = to_vector3(p_Rcm, "p_Rcm");
            at.point -= origin;
            return wall_at(at, to_vector3(p_Tip, "p_Tip") - origin).distance;
          },
          py::arg("p_Tip"), py::arg("p_Rcm"),
          "How far [m] tip or shaft, from p_Rcm to p_Tip, is on the allowed side.");
}

}  // namespace surg::python
