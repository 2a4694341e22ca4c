#include "surg_core/files/urdf.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

#include "files/text_file.hpp"
#include "files/urdf_numbers.hpp"
#include "files/xml.hpp"

namespace surg {
namespace {

using files::Element;
using files::refuse;

constexpr double kNoDirection = 1e-6;  // as written: a shorter one has no direction
constexpr const char* kKinds[] = {"revolute", "continuous", "prismatic",
                                  "fixed",    "floating",   "planar"};

std::string listed(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text.empty() ? "none" : text;
}

/// Rotation of 'rpy', to the last bit what urdfdom and Eigen get: its quaternion, normalised twice.
/// A last bit that differs would grow into another trajectory within seconds, and a simulation
/// could not be compared by its hash with one of before.
Matrix3 rotation_of(const Vector3& rpy) {
  const double phi = rpy.x() / 2.0, the = rpy.y() / 2.0, psi = rpy.z() / 2.0;
  const double sx = std::sin(phi), cx = std::cos(phi), sy = std::sin(the), cy = std::cos(the);
  const double sz = std::sin(psi), cz = std::cos(psi);
  double x = sx * cy * cz - cx * sy * sz;
  double y = cx * sy * cz + sx * cy * sz;
  double z = cx * cy * sz - sx * sy * cz;
  double w = cx * cy * cz + sx * sy * sz;
  const double length = std::sqrt(x * x + y * y + z * z + w * w);
  x /= length, y /= length, z /= length, w /= length;
  return Eigen::Quaterniond(w, x, y, z).normalized().toRotationMatrix();
}

std::string name_of(const Element& element, const std::string& file) {
  const std::string* name = element.attribute("name");
  if (!name || name->empty()) refuse(file, element.line, "a <" + element.name + "> has no name");
  return *name;
}

/// Checks what physics needs of a link, where the file states it.
void check_inertial(const Element& link, const std::string& name, const std::string& file) {
  const Element* inertial = link.child("inertial");
  if (!inertial) return;
  const Element* mass = inertial->child("mass");
  const Element* inertia = inertial->child("inertia");
  const auto stated = [&](const char* key) { return inertia && inertia->attribute(key); };
  const bool whole = mass && mass->attribute("value") && stated("ixx") && stated("iyy") &&
                     stated("izz") && stated("ixy") && stated("ixz") && stated("iyz");
  if (!whole) {
    refuse(
        file, inertial->line,
        "link '" + name + "': <inertial> needs <mass value> and <inertia ixx iyy izz ixy ixz iyz>");
  }
  const auto value = [&](const char* key) { return *files::number_in(*inertia, key); };
  Matrix3 I;
  I << value("ixx"), value("ixy"), value("ixz"), value("ixy"), value("iyy"), value("iyz"),
      value("ixz"), value("iyz"), value("izz");
  const Vector3 moments =
      Eigen::SelfAdjointEigenSolver<Matrix3>(I, Eigen::EigenvaluesOnly).eigenvalues();
  if (!(moments.minCoeff() >= -1e-9 * moments.cwiseAbs().maxCoeff())) {
    refuse(file, inertia->line,
           "link '" + name + "': no body has this <inertia>: a principal moment is negative");
  }
}

UrdfJoint read_joint(const Element& element, const std::string& file) {
  UrdfJoint joint;
  joint.name = name_of(element, file);
  joint.line = element.line;
  const auto fail = [&](const std::string& what) {
    refuse(file, element.line, "joint '" + joint.name + "' " + what);
  };
  const std::string* kind = element.attribute("type");
  joint.kind = kind ? *kind : "";
  if (std::count(std::begin(kKinds), std::end(kKinds), joint.kind) == 0) {
    fail("is of type '" + joint.kind + "'; allowed are " +
         listed({std::begin(kKinds), std::end(kKinds)}));
  }
  const auto link_in = [&](const char* tag) {
    const Element* child = element.child(tag);
    const std::string* link = child ? child->attribute("link") : nullptr;
    if (!link || link->empty()) fail("has no <" + std::string(tag) + " link=\"…\"/>");
    return *link;
  };
  joint.parent = link_in("parent");
  joint.child = link_in("child");
  const Element* origin = element.child("origin");
  joint.xyz = files::vector_in(origin, "xyz", Vector3::Zero());
  joint.rpy = files::vector_in(origin, "rpy", Vector3::Zero());
  joint.X_PJ.linear() = rotation_of(joint.rpy);
  joint.X_PJ.translation() = joint.xyz;
  const Vector3 axis = files::vector_in(element.child("axis"), "xyz", Vector3::UnitX());
  joint.axis = axis.norm() > kNoDirection ? axis.normalized() : Vector3::Zero().eval();
  if (const Element* limit = element.child("limit")) {
    joint.limit = UrdfLimit{files::number_in(*limit, "lower"), files::number_in(*limit, "upper"),
                            files::number_in(*limit, "velocity")};
  }
  const Element* mimic = element.child("mimic");
  const std::string* leader = mimic ? mimic->attribute("joint") : nullptr;
  if (leader) {
    joint.mimic = UrdfMimic{*leader, files::number_in(*mimic, "multiplier").value_or(1),
                            files::number_in(*mimic, "offset").value_or(0)};
  }
  return joint;
}

/// Refuses links and joints that are not one tree.
void check_tree(const Urdf& urdf) {
  std::map<std::string, const UrdfJoint*> above;
  std::set<std::string> links(urdf.links.begin(), urdf.links.end()), names;
  for (const UrdfJoint& joint : urdf.joints) {
    const auto fail = [&](const std::string& what) { refuse(urdf.file, joint.line, what); };
    if (!names.insert(joint.name).second) fail("two joints are called '" + joint.name + "'");
    for (const std::string& link : {joint.parent, joint.child}) {
      if (!links.count(link)) {
        fail("joint '" + joint.name + "' names the link '" + link + "', which is not in the file");
      }
    }
    if (!above.emplace(joint.child, &joint).second) {
      fail("link '" + joint.child + "' is the child of two joints");
    }
  }
  std::string root;
  for (const std::string& start : urdf.links) {
    std::string link = start;
    for (std::size_t up = 0; above.count(link); link = above.at(link)->parent) {
      if (up++ < above.size()) continue;
      refuse(urdf.file, above.at(start)->line,
             "link '" + start + "' does not hang below a root: its joints form a ring");
    }
    if (!root.empty() && link != root) {
      refuse(urdf.file, 0,
             "has two roots, '" + root + "' and '" + link +
                 "': all links but one must hang on a joint");
    }
    root = link;
  }
}

/// Refuses a turning joint without the limits that URDF demands.
void check_limit(const Urdf& urdf, const UrdfJoint& joint) {
  const auto fail = [&](const std::string& what) {
    refuse(urdf.file, joint.line, joint.kind + " joint '" + joint.name + "' " + what);
  };
  const std::optional<UrdfLimit>& limit = joint.limit;
  if (joint.kind == "revolute" && !(limit && limit->lower && limit->upper)) {
    fail(
        "has no <limit lower=\"…\" upper=\"…\" velocity=\"…\"/>: state its range [rad] and speed "
        "[rad/s], or make it continuous");
  }
  if (!limit) return;
  if (!limit->velocity) fail("has no <limit velocity=\"…\"/>: state its speed [rad/s]");
  if (!(*limit->velocity > 0)) {
    fail(
        "has <limit velocity=\"0\"/>: a joint that cannot move is no arm's; state its speed, "
        "above 0 rad/s");
  }
  if (joint.kind == "revolute" && !(*limit->lower < *limit->upper)) {
    fail("has a <limit> whose lower is not below its upper: exchange them [rad]");
  }
}

}  // namespace

Urdf load_urdf(const std::string& path) {
  Urdf urdf{path, files::read_xml_text(path), {}, {}};
  const Element root = files::parse_xml(urdf.text, path);
  if (root.name != "robot") {
    refuse(path, root.line, "the root element is <" + root.name + ">; a URDF's is <robot>");
  }
  files::check_numbers(root, path);
  std::set<std::string> links;
  for (const Element& element : root.children) {
    if (element.name == "link") {
      const std::string name = name_of(element, path);
      if (!links.insert(name).second) {
        refuse(path, element.line, "two links are called '" + name + "'");
      }
      check_inertial(element, name, path);
      urdf.links.push_back(name);
    } else if (element.name == "joint") {
      urdf.joints.push_back(read_joint(element, path));
    }
  }
  check_tree(urdf);
  return urdf;
}

std::vector<UrdfJoint> joints_between(const Urdf& urdf, const std::string& start,
                                      const std::string& end) {
  for (const std::string& link : {start, end}) {
    if (std::count(urdf.links.begin(), urdf.links.end(), link) == 0) {
      refuse(urdf.file, 0, "has no link '" + link + "'; it has " + listed(urdf.links));
    }
  }
  std::vector<UrdfJoint> way;
  for (std::string link = end; link != start; link = way.back().parent) {
    const auto joint = std::find_if(urdf.joints.begin(), urdf.joints.end(),
                                    [&](const UrdfJoint& j) { return j.child == link; });
    if (joint == urdf.joints.end()) {
      refuse(urdf.file, 0, "link '" + end + "' does not hang below link '" + start + "'");
    }
    way.push_back(*joint);
  }
  std::reverse(way.begin(), way.end());
  for (const UrdfJoint& joint : way) {
    if (!joint.turning() && joint.kind != "fixed") {
      refuse(urdf.file, joint.line,
             "joint '" + joint.name + "' is of type '" + joint.kind +
                 "'; allowed are revolute, continuous, fixed");
    }
    if (joint.turning() && joint.axis.isZero()) {
      refuse(urdf.file, joint.line, "joint '" + joint.name + "': the axis has length zero");
    }
  }
  return way;
}

Chain chain_of(const Urdf& urdf, const std::string& base, const std::string& flange,
               const std::vector<std::string>& joint_names) {
  const std::vector<UrdfJoint> joints = joints_between(urdf, base, flange);
  std::vector<std::string> turning;
  std::vector<Joint> chain;
  Pose X = Pose::Identity();  // of the present link in the last turning joint's frame
  for (const UrdfJoint& joint : joints) {
    X = X * joint.X_PJ;
    if (!joint.turning()) continue;
    turning.push_back(joint.name);
    chain.push_back({joint.name, X, joint.axis, joint.kind == "continuous"});
    X = Pose::Identity();
  }
  if (turning != joint_names) {
    refuse(urdf.file, 0,
           "from link '" + base + "' to link '" + flange + "' the turning joints are " +
               listed(turning) + "; the robot's joints.names says " + listed(joint_names) +
               ": write the former, in this order");
  }
  for (const UrdfJoint& joint : joints) {
    if (joint.turning()) check_limit(urdf, joint);
  }
  try {
    return Chain(std::move(chain), X);
  } catch (const std::invalid_argument& error) {
    refuse(urdf.file, 0, error.what());
  }
}

Pose fixed_transform(const Urdf& urdf, const std::string& parent, const std::string& child) {
  Pose X = Pose::Identity();
  for (const UrdfJoint& joint : joints_between(urdf, parent, child)) {
    const bool of_wrist =
        std::find(kWristJoints.begin(), kWristJoints.end(), joint.name) != kWristJoints.end();
    if (joint.turning() && !of_wrist) {
      refuse(urdf.file, joint.line,
             "joint '" + joint.name + "' between link '" + parent + "' and link '" + child +
                 "' is " + joint.kind + "; it must be fixed");
    }
    X = X * joint.X_PJ;
  }
  return X;
}

}  // namespace surg
