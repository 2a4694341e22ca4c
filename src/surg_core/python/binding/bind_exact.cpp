#include <pybind11/stl.h>

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "convert.hpp"
#include "surg_core/kinematics/ur_inverse.hpp"
#include "surg_core/law/exact.hpp"
#include "surg_core/law/exact_follower.hpp"

namespace surg::python {
namespace {

using RowMajor4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

Tool to_tool(const Array& s_F, const Array& p_FTip) {
  return {to_vector3(s_F, "s_F"), to_vector3(p_FTip, "p_FTip")};
}

JointVector to_posture(const std::optional<Array>& posture, int dof) {
  return posture ? to_joints(*posture, dof, "posture") : JointVector(JointVector::Zero(dof));
}

/// Rows of an array whose last dimensions are 'row'; ValueError otherwise.
py::ssize_t rows_of(const Array& array, const std::vector<py::ssize_t>& row, const char* name) {
  bool fits = array.ndim() == static_cast<py::ssize_t>(row.size()) + 1;
  std::string wanted = "(m";
  for (std::size_t i = 0; i < row.size(); ++i) {
    fits = fits && array.shape(static_cast<py::ssize_t>(i) + 1) == row[i];
    wanted += ", " + std::to_string(row[i]);
  }
  if (!fits) {
    throw py::value_error(std::string(name) + ": shape " + wanted + (row.empty() ? ",)" : ")") +
                          " is needed, not " + shape_of(array));
  }
  return array.shape(0);
}

/// One pose of a batch, checked like a single one.
Pose pose_at(const Array& poses, py::ssize_t i) {
  Array one({4, 4});
  std::copy_n(poses.data(i), 16, one.mutable_data());
  return to_pose(one, ("X_BFGoals[" + std::to_string(i) + "]").c_str());
}

Array poses_on_pivot(const Home& home, const Array& s_F, const Array& p_FTip, const Array& p_BRcm,
                     const Array& p_BTip, const Array& roll) {
  const Tool tool = to_tool(s_F, p_FTip);
  const Vector3 rcm = to_vector3(p_BRcm, "p_BRcm");
  const py::ssize_t m = rows_of(p_BTip, {3}, "p_BTip");
  check_shape(roll, {m}, "roll");
  Array poses({m, py::ssize_t{4}, py::ssize_t{4}});
  const double *tips = p_BTip.data(), *rolls = roll.data();
  double* out = poses.mutable_data();
  {
    const py::gil_scoped_release release;
    for (py::ssize_t i = 0; i < m; ++i) {
      const Vector3 tip = Eigen::Map<const Vector3>(tips + 3 * i);
      const ShaftGoal goal = tip_goal(rcm, tip, rolls[i], home.s_B);
      Eigen::Map<RowMajor4>(out + 16 * i) = pose_on_pivot(home, tool, goal).matrix();
    }
  }
  return poses;
}

/// Joints along an array of goals, each step from the joints of the one before.
py::tuple follow(const NextPose& next, int dof, const Array& q_start, const Array& goals,
                 const std::optional<Array>& q_posture, double pull) {
  const py::ssize_t m = rows_of(goals, {4, 4}, "X_BFGoals");
  JointVector q = to_joints(q_start, dof, "q");
  const JointVector wish = q_posture ? to_joints(*q_posture, dof, "q_posture") : q;
  std::vector<Pose> poses;
  poses.reserve(static_cast<std::size_t>(m));
  for (py::ssize_t i = 0; i < m; ++i) poses.push_back(pose_at(goals, i));
  Array joints({m, static_cast<py::ssize_t>(dof)});
  Array conditioning(m);
  double *out = joints.mutable_data(), *condition = conditioning.mutable_data();
  {
    const py::gil_scoped_release release;
    for (py::ssize_t i = 0; i < m; ++i) {
      const JointStep step = next.step(q, poses[static_cast<std::size_t>(i)], pull * (wish - q));
      q += step.dq;
      std::copy_n(q.data(), dof, out + i * dof);
      condition[i] = step.conditioning;
    }
  }
  return py::make_tuple(joints, conditioning);
}

void bind_goals(py::module_& testing) {
  py::class_<Home>(testing, "Home", "Shaft axis and flange orientation at home: zero of the roll.")
      .def(py::init([](const Array& X_BF, const Array& s_F, const Array& p_FTip) {
             return home_of(to_pose(X_BF, "X_BF"), to_tool(s_F, p_FTip));
           }),
           py::arg("X_BF"), py::arg("s_F"), py::arg("p_FTip"),
           "From the flange pose (4, 4) at home and the tool calibration (3,), (3,) in F.")
      .def_property_readonly("s_B", [](const Home& h) { return frozen(from_matrix(h.s_B)); })
      .def_property_readonly("R_BF", [](const Home& h) { return frozen(from_matrix(h.R_BF)); });

  py::class_<ShaftGoal>(testing, "ShaftGoal",
                        "Where the instrument shall be: the four degrees of freedom that a trocar "
                        "leaves, in B.")
      .def(py::init([](const Array& p_BRcm, const Array& s_B, double depth, double roll) {
             return ShaftGoal{to_vector3(p_BRcm, "p_BRcm"), to_vector3(s_B, "s_B"), depth, roll};
           }),
           py::arg("p_BRcm"), py::arg("s_B"), py::arg("depth"), py::arg("roll"),
           "Trocar (3,) [m], unit shaft axis (3,), depth [m] (negative: outside), roll [rad].")
      .def_property_readonly("p_BRcm",
                             [](const ShaftGoal& g) { return frozen(from_matrix(g.p_BRcm)); })
      .def_property_readonly("s_B", [](const ShaftGoal& g) { return frozen(from_matrix(g.s_B)); })
      .def_readonly("depth", &ShaftGoal::depth)
      .def_readonly("roll", &ShaftGoal::roll)
      .def_property_readonly("p_BTip",
                             [](const ShaftGoal& g) { return frozen(from_matrix(g.p_BTip())); });

  testing.def(
      "tip_goal",
      [](const Array& p_BRcm, const Array& p_BTip, double roll, const Array& otherwise) {
        return tip_goal(to_vector3(p_BRcm, "p_BRcm"), to_vector3(p_BTip, "p_BTip"), roll,
                        to_vector3(otherwise, "otherwise"));
      },
      py::arg("p_BRcm"), py::arg("p_BTip"), py::arg("roll"), py::arg("otherwise"),
      "The ShaftGoal whose tip is p_BTip (3,) [m], deeper than the trocar; 'otherwise' (3,) is "
      "the\n"
      "shaft axis where both coincide.");
  testing.def(
      "spherical_goal",
      [](const Array& X_BR, const Array& joints) {
        return spherical_goal(to_pose(X_BR, "X_BR"), to_vector4(joints, "virtual_joints"));
      },
      py::arg("X_BR"), py::arg("virtual_joints"),
      "The ShaftGoal (yaw, pitch, insertion, roll) (4,) [rad, rad, m, rad] in the trocar frame "
      "(4, 4).");
  testing.def(
      "pose_on_pivot",
      [](const Home& home, const Array& s_F, const Array& p_FTip, const ShaftGoal& goal) {
        return from_pose(pose_on_pivot(home, to_tool(s_F, p_FTip), goal));
      },
      py::arg("home"), py::arg("s_F"), py::arg("p_FTip"), py::arg("goal"),
      "X_BF (4, 4) on the constraint by construction.");
  testing.def("poses_on_pivot", &poses_on_pivot, py::arg("home"), py::arg("s_F"), py::arg("p_FTip"),
              py::arg("p_BRcm"), py::arg("p_BTip"), py::arg("roll"),
              "X_BF (m, 4, 4) for tips (m, 3) [m] and rolls (m,) [rad]. Releases the GIL.");
}

void bind_steps(py::module_& testing) {
  py::class_<JointStep>(testing, "JointStep", "A displacement of the joints.")
      .def_property_readonly("dq", [](const JointStep& s) { return frozen(from_matrix(s.dq)); })
      .def_readonly("conditioning", &JointStep::conditioning,
                    "How far from a singularity; 0: singular or out of reach, and dq is zero.");

  testing.def(
      "exact_step",
      [](const Chain& chain, const Array& q, const Array& X_BFGoal,
         const std::optional<Array>& posture) {
        return exact_step(chain, to_joints(q, chain.dof(), "q"), to_pose(X_BFGoal, "X_BFGoal"),
                          to_posture(posture, chain.dof()));
      },
      py::arg("chain"), py::arg("q"), py::arg("X_BFGoal"), py::arg("posture") = py::none(),
      "Joints (n,) [rad] to a pose (4, 4) one control cycle away, in two stages: prediction and\n"
      "Newton correction. 'posture' (n,) [rad] is the displacement that a null space would like.");

  // The chain's size is kept beside: the class itself has no use for it.
  struct PyNextPose {
    NextPose next;
    int dof;
  };
  py::class_<PyNextPose>(testing, "NextPose",
                         "Joints for the next pose: closed form for the UR family, else "
                         "exact_step.")
      .def(py::init([](const Chain& chain, bool closed_form) {
             return PyNextPose{NextPose(chain, closed_form), chain.dof()};
           }),
           py::arg("chain"), py::arg("closed_form") = true)
      .def_property_readonly("closed_form",
                             [](const PyNextPose& n) { return n.next.closed_form(); })
      .def(
          "step",
          [](const PyNextPose& n, const Array& q, const Array& X_BFGoal,
             const std::optional<Array>& posture) {
            return n.next.step(to_joints(q, n.dof, "q"), to_pose(X_BFGoal, "X_BFGoal"),
                               to_posture(posture, n.dof));
          },
          py::arg("q"), py::arg("X_BFGoal"), py::arg("posture") = py::none(),
          "The JointStep from q (n,) [rad] to a pose (4, 4) nearby.")
      .def(
          "follow",
          [](const PyNextPose& n, const Array& q, const Array& goals,
             const std::optional<Array>& q_posture,
             double pull) { return follow(n.next, n.dof, q, goals, q_posture, pull); },
          py::arg("q"), py::arg("X_BFGoals"), py::arg("q_posture") = py::none(),
          py::arg("pull") = 0.0,
          "Joints along poses (m, 4, 4), from q (n,) on, each a step from the one before.\n\n"
          "With spare joints each step also asks for 'pull' times the way to q_posture (n,), the\n"
          "start if None. Returns joints (m, n) [rad] and conditioning (m,); where that is 0 the\n"
          "joints stay. Releases the GIL.");
}

void bind_rows(py::module_& testing) {
  py::class_<RcmRows>(testing, "RcmRows", "The two rows that keep the pivot.")
      .def_property_readonly("J", [](const RcmRows& r) { return frozen(from_matrix(r.J)); })
      .def_property_readonly("e", [](const RcmRows& r) { return frozen(from_matrix(r.e)); });
  testing.def(
      "rcm_rows",
      [](const Array& J, const ShaftState& shaft) { return rcm_rows(to_jacobian(J, "J"), shaft); },
      py::arg("J"), py::arg("shaft"),
      "Lateral velocity (2, n) of the shaft point at the trocar per joint velocity, and the "
      "lateral\n"
      "error (2,) [m] in the same two directions, from the Jacobian (6, n).");
  testing.def("rcm_correction", &rcm_correction, py::arg("rows"),
              "The smallest JointStep that, to first order, puts the shaft back on the trocar.");
}

void bind_ur(py::module_& testing) {
  py::class_<UrSolution>(testing, "UrSolution",
                         "One posture and its signed measures, 0 at a singularity.")
      .def_property_readonly("q", [](const UrSolution& s) { return frozen(from_matrix(s.q)); })
      .def_readonly("shoulder", &UrSolution::shoulder, "[m] reach of the wrist centre.")
      .def_readonly("elbow", &UrSolution::elbow, "Sine of the elbow.")
      .def_readonly("wrist", &UrSolution::wrist, "Sine of wrist 2.");
  py::class_<UrInverse>(testing, "UrInverse", "Closed-form inverse kinematics of the UR family.")
      .def(py::init([](const Chain& chain) {
             std::string why;
             std::optional<UrInverse> inverse = UrInverse::of(chain, &why);
             if (!inverse) throw py::value_error(why);
             return *inverse;
           }),
           py::arg("chain"), "Raises ValueError with the reason for arms of another build.")
      .def(
          "solve_all",
          [](const UrInverse& inverse, const Array& X_BF, const Array& near) {
            const UrSolutions found =
                inverse.solve_all(to_pose(X_BF, "X_BF"), to_joints(near, 6, "near"));
            return std::vector<UrSolution>(found.all.begin(), found.all.begin() + found.count);
          },
          py::arg("X_BF"), py::arg("near"),
          "Every posture that puts the flange at X_BF (4, 4), up to eight, each joint within half\n"
          "a turn of near (6,) [rad].");
}

void bind_follower(py::module_& testing) {
  struct PyFollower {
    ExactFollower follower;
    int dof;
  };
  py::class_<PyFollower>(testing, "ExactFollower",
                         "Makes a lagging arm follow a virtual reference, and learns each joint's "
                         "lag.")
      .def(
          py::init([](int joints, double lag, double gain, double learning, double T,
                      const std::optional<Array>& velocity,
                      const std::optional<Array>& acceleration) {
            if (joints < 1 || joints > kMaxJoints) {
              throw py::value_error("joints: 1 to " + std::to_string(kMaxJoints) + ", not " +
                                    std::to_string(joints));
            }
            if (!(lag >= 0 && gain >= 0 && learning >= 0 && T > 0)) {
              throw py::value_error("lag, gain, learning: 0 or more; T: more than 0");
            }
            ExactFollower::Options options{lag, gain, learning, T};
            if (velocity) options.velocity = to_joints(*velocity, joints, "velocity");
            if (acceleration) {
              options.acceleration = to_joints(*acceleration, joints, "acceleration");
            }
            return PyFollower{ExactFollower(joints, options), joints};
          }),
          py::arg("joints"), py::arg("lag"), py::arg("gain") = 50.0, py::arg("learning") = 2.0,
          py::arg("T") = 0.002, py::arg("velocity") = py::none(),
          py::arg("acceleration") = py::none(),
          "lag [s] of the link as stated, gain [1/s] of the feedback, learning [1/s] of the lags\n"
          "(0: none), T [s] control period; velocity [rad/s] and acceleration [rad/s^2] (n,) bound "
          "the\n"
          "correction that is added to the reference's own velocity.")
      .def(
          "reset",
          [](PyFollower& f, const Array& q) { f.follower.reset(to_joints(q, f.dof, "q")); },
          py::arg("q"), "The reference is where the arm is (n,) [rad], at rest.")
      .def(
          "advance",
          [](PyFollower& f, const Array& dq, const Array& q) {
            return from_matrix(
                f.follower.advance(to_joints(dq, f.dof, "dq"), to_joints(q, f.dof, "q")));
          },
          py::arg("dq"), py::arg("q"),
          "Moves the reference on by dq (n,) [rad]; the link's command (n,) [rad/s] for measured\n"
          "joints q (n,) [rad].")
      .def_property_readonly(
          "reference",
          [](const PyFollower& f) { return frozen(from_matrix(f.follower.reference())); })
      .def_property_readonly(
          "lag", [](const PyFollower& f) { return frozen(from_matrix(f.follower.lag())); },
          "Each joint's lag (n,) as learnt so far [s].");
}

}  // namespace

void bind_exact(py::module_& testing) {
  bind_goals(testing);
  bind_steps(testing);
  bind_rows(testing);
  bind_ur(testing);
  bind_follower(testing);
}

}  // namespace surg::python
