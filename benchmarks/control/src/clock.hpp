// Time of single cycles, and statistics of them.
#pragma once

#include <algorithm>
#include <chrono>
#include <vector>

namespace bench {

/// Nanoseconds of one call; the caller takes off what an empty one takes.
template <typename Call>
float nanoseconds(Call&& call) {
  const auto begin = std::chrono::steady_clock::now();
  call();
  const auto end = std::chrono::steady_clock::now();
  return static_cast<float>(std::chrono::duration<double, std::nano>(end - begin).count());
}

inline double quantile(std::vector<float> values, double q) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<long>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// What measuring nothing takes [ns], the median.
inline double empty_call() {
  std::vector<float> times;
  for (int i = 0; i < 100000; ++i) times.push_back(nanoseconds([] {}));
  return quantile(times, 0.5);
}

/// Median and 99th percentile [us], without what an empty call takes.
struct Cost {
  Cost(const std::vector<float>& times, double empty)
      : median(std::max(0.0, quantile(times, 0.5) - empty) * 1e-3),
        p99(std::max(0.0, quantile(times, 0.99) - empty) * 1e-3) {}
  double median, p99;
};

}  // namespace bench
