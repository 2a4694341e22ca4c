#include "arm.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <stdexcept>

namespace bench {
namespace {

using surg::JointVector;
using surg::Pose;
using surg::Vector3;

std::ifstream open(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw std::runtime_error("cannot read " + file);
  return in;
}

/// Reads the numbers behind the expected word.
void expect(std::istream& in, const std::string& word) {
  std::string found;
  in >> found;
  if (found != word) throw std::runtime_error("arm file: '" + word + "' expected, not " + found);
}
JointVector joints(std::istream& in, const std::string& word, int n) {
  expect(in, word);
  JointVector values(n);
  for (int i = 0; i < n; ++i) in >> values[i];
  return values;
}
Vector3 vector(std::istream& in, const std::string& word) {
  expect(in, word);
  Vector3 v;
  in >> v[0] >> v[1] >> v[2];
  return v;
}
Pose pose(std::istream& in, const std::string& word) {
  expect(in, word);
  Pose X = Pose::Identity();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 4; ++c) in >> X.matrix()(r, c);
  }
  return X;
}

}  // namespace

Vector3 Scene::tip(double t) const {
  const double k = std::clamp(t / T, 0.0, static_cast<double>(p_BTip.size() - 1));
  const std::size_t i = std::min(static_cast<std::size_t>(k), p_BTip.size() - 2);
  return p_BTip[i] + (k - static_cast<double>(i)) * (p_BTip[i + 1] - p_BTip[i]);
}

Scene read_scene(const std::string& arm_file, const std::string& path_file) {
  Scene scene;
  std::ifstream in = open(arm_file);
  int n = 0;
  expect(in, "name");
  in >> scene.name;
  expect(in, "joints");
  in >> n;
  std::vector<surg::Joint> chain(n);
  for (surg::Joint& joint : chain) {
    joint.X_PJ = pose(in, "X_PJ");
    joint.axis = vector(in, "axis");
  }
  scene.chain = surg::Chain(chain, pose(in, "X_LF"));
  scene.q_home = joints(in, "home", n);
  scene.limits.position_min = joints(in, "position_min", n);
  scene.limits.position_max = joints(in, "position_max", n);
  scene.limits.velocity = joints(in, "velocity", n);
  scene.limits.acceleration = joints(in, "acceleration", n);
  expect(in, "flange_velocity");
  in >> scene.limits.flange_velocity;
  scene.tool.s_F = vector(in, "shaft_axis");
  scene.tool.p_FTip = vector(in, "tip");
  scene.p_BRcm = vector(in, "trocar");
  if (!in) throw std::runtime_error(arm_file + ": too short");
  scene.home = surg::home_of(scene.chain.forward(scene.q_home), scene.tool);

  std::ifstream path = open(path_file);
  Vector3 p;
  while (path.read(reinterpret_cast<char*>(p.data()), sizeof(double) * 3)) {
    scene.p_BTip.push_back(p);
  }
  if (scene.p_BTip.size() < 2) throw std::runtime_error(path_file + ": no path");
  return scene;
}

Task task_at(const Scene& scene, const JointVector& q, const Goal& goal) {
  Task task;
  Pose X_BF;
  scene.chain.forward(q, X_BF, task.J);
  task.shaft = surg::shaft_state(X_BF, scene.tool, scene.p_BRcm);
  const Vector3& s = task.shaft.s;
  task.v_tip = (goal.p_next - goal.p_now) / T + kTipGain * (goal.p_now - task.shaft.p_BTip);
  // The roll stays 0: feedback, and the rotation that the minimal rotation to s(t) itself has.
  const double roll = surg::absolute_roll(X_BF.linear(), scene.home.R_BF, scene.home.s_B, s);
  const Vector3 v = task.v_tip - kRcmGain * task.shaft.e;
  const Vector3 s_dot = (v - s * s.dot(v)) / task.shaft.depth;
  task.roll_rate = -kRollGain * roll + surg::roll_holonomy_rate(scene.home.s_B, s, s_dot);
  task.posture = JointVector::Zero(q.size());
  if (q.size() > 6) task.posture = kPostureGain * (scene.q_home - q);
  return task;
}

Programme programme_at(const Scene& scene, const JointVector& q, const JointVector& qd_last,
                       const Goal& goal) {
  const Task task = task_at(scene, q, goal);
  const Eigen::Index n = q.size();
  const Vector3 arm = task.shaft.p_BTip - task.shaft.p_BF;
  Programme programme;
  // Rows of the task: tip velocity (3) and roll (1); one column per joint, so that no product of
  // dynamic size takes Eigen's general paths.
  Eigen::Matrix<double, 4, Eigen::Dynamic, 0, 4, surg::kMaxJoints> A(4, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Vector3 w = task.J.col(i).tail<3>();
    A.col(i).head<3>() = task.J.col(i).head<3>() + w.cross(arm);
    A(3, i) = std::sqrt(Programme::kRollWeight) * task.shaft.s.dot(w);
  }
  Eigen::Vector4d wish;
  wish << task.v_tip, std::sqrt(Programme::kRollWeight) * task.roll_rate;
  programme.H.resize(n, n);
  programme.g.resize(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Vector4d column = A.col(i);
    for (Eigen::Index j = 0; j <= i; ++j) {
      programme.H(i, j) = programme.H(j, i) = column.dot(Eigen::Vector4d(A.col(j)));
    }
    programme.H(i, i) += Programme::kPostureWeight;
    programme.g[i] = -column.dot(wish) - Programme::kPostureWeight * task.posture[i];
  }
  programme.rows = surg::rcm_rows(task.J, task.shaft);
  programme.b = kRcmGain * programme.rows.e;
  programme.lower.resize(n);
  programme.upper.resize(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double v = scene.limits.velocity[i], dv = scene.limits.acceleration[i] * T;
    programme.lower[i] = std::max({-v, qd_last[i] - dv, (scene.limits.position_min[i] - q[i]) / T});
    programme.upper[i] = std::min({v, qd_last[i] + dv, (scene.limits.position_max[i] - q[i]) / T});
  }
  return programme;
}

}  // namespace bench
