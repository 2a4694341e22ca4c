#include <gtest/gtest.h>

#include "support/test_arm.hpp"
#include "support/test_support.hpp"
#include "surg_core/limits/stop_bound.hpp"

namespace surg {
namespace {

/// Fast and slow, wherever the joints are, behind short and long lags.
void expect_no_heap(const Chain& chain, const JointVector& home, const JointVector& most) {
  const Eigen::Index n = chain.dof();
  test::Random random(1);
  const StopRanges ranges{0.04, 20, 0.25 * most, 2 * most};
  StopEstimator stops(ranges, 0.002);
  for (int k = 0; k < test::family(500, 20000); ++k) {
    JointVector q(n), qd(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      q[i] = home[i] + random.uniform(-1, 1);
      qd[i] = random.uniform(-1, 1) * random.magnitude(1e-6, 2);
    }
    const StopEstimator::Now now{q,
                                 qd,
                                 random.uniform(0, 0.04),
                                 random.uniform(0, 0.04),
                                 {Vector3::UnitZ(), {0.06, 0, 0.3}},
                                 {0.4, 0.1, 0.2}};
    test::HeapWatch watch;
    stops.add(qd);
    const StopBound bound = stops.bound(chain, now);
    ASSERT_EQ(watch.calls(), 0) << "state " << k;
    ASSERT_GE(bound.tip, 0);
    ASSERT_GE(bound.pivot, 0);
  }
}

TEST(StopBound, LeavesTheHeapAlone) {
  expect_no_heap(test::ur5e_chain(), test::ur5e_home(), JointVector::Constant(6, 15));
  expect_no_heap(test::panda_chain(), test::panda_home(), test::panda_acceleration());
}

}  // namespace
}  // namespace surg
