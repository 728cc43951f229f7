// The bar problem solved by Ceres: automatic derivatives, DENSE_SCHUR with the markers eliminated first.
//
//   ceres_bar PROBLEM THREADS
//
// PROBLEM (written by scripts/bench_bar.py, doubles): blocks, length, sigma_px, sigma_length; 18 shared start values
// (fx fy cx cy k1 k2 of both cameras, rotation vector and translation of the second); per block 6 start values
// (markers a, b) and 8 pixels (a in camera 1, a in camera 2, b in camera 1, b in camera 2).
// Prints one line "iteration SECONDS COST" for every accepted point, and "solve SECONDS COST" for Solve() alone.

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <vector>

namespace {

template <typename T>
void Residual(const T* camera, const T* p, const double* uv, double sigma, T* r) {
  const T x = p[0] / p[2], y = p[1] / p[2];
  const T r2 = x * x + y * y;
  const T radial = 1.0 + r2 * (camera[4] + r2 * camera[5]);
  r[0] = (camera[0] * x * radial + camera[2] - uv[0]) / sigma;
  r[1] = (camera[1] * y * radial + camera[3] - uv[1]) / sigma;
}

// One parameter block per bar: the length joins its markers, and what is eliminated may not be joined.
struct FirstCamera {
  const double* uv;
  double sigma;
  int marker;
  template <typename T>
  bool operator()(const T* camera, const T* bar, T* r) const {
    Residual(camera, bar + 3 * marker, uv, sigma, r);
    return true;
  }
};

struct SecondCamera {
  const double* uv;
  double sigma;
  int marker;
  template <typename T>
  bool operator()(const T* camera, const T* pose, const T* bar, T* r) const {
    T q[3];
    ceres::AngleAxisRotatePoint(pose, bar + 3 * marker, q);
    for (int i = 0; i < 3; ++i) q[i] += pose[3 + i];
    Residual(camera, q, uv, sigma, r);
    return true;
  }
};

struct Length {
  double length, sigma;
  template <typename T>
  bool operator()(const T* bar, T* r) const {
    const T d[3] = {bar[0] - bar[3], bar[1] - bar[4], bar[2] - bar[5]};
    r[0] = (sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) - length) / sigma;
    return true;
  }
};

double Now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

struct Log : ceres::IterationCallback {
  double start = 0;
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& s) override {
    if (s.step_is_successful || s.iteration == 0) std::printf("iteration %.9f %.17g\n", Now() - start, s.cost);
    return ceres::SOLVER_CONTINUE;
  }
};

std::vector<double> Read(const char* path) {
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return {};
  std::vector<double> numbers(static_cast<size_t>(file.tellg()) / sizeof(double));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(numbers.data()), numbers.size() * sizeof(double));
  return numbers;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: ceres_bar PROBLEM THREADS\n"), 2;
  std::vector<double> z = Read(argv[1]);
  const size_t blocks = z.empty() ? 0 : static_cast<size_t>(z[0]);
  if (z.size() != 22 + 14 * blocks) return std::fprintf(stderr, "%s: not a bar problem\n", argv[1]), 2;
  const double length = z[1], sigma_px = z[2], sigma_length = z[3];
  double *camera1 = &z[4], *camera2 = &z[10], *pose = &z[16];

  ceres::Problem problem;
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (double* shared : {camera1, camera2, pose}) ordering->AddElementToGroup(shared, 1);
  for (size_t i = 0; i < blocks; ++i) {
    double* bar = &z[22 + 14 * i];
    const double* uv = bar + 6;
    for (int k = 0; k < 2; ++k) {
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<FirstCamera, 2, 6, 6>(new FirstCamera{uv + 4 * k, sigma_px, k}), nullptr,
          camera1, bar);
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<SecondCamera, 2, 6, 6, 6>(new SecondCamera{uv + 4 * k + 2, sigma_px, k}),
          nullptr, camera2, pose, bar);
    }
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Length, 1, 6>(new Length{length, sigma_length}),
                             nullptr, bar);
    ordering->AddElementToGroup(bar, 0);
  }

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering.reset(ordering);
  options.num_threads = std::atoi(argv[2]);
  options.max_num_iterations = 200;
  options.function_tolerance = 1e-14;
  options.gradient_tolerance = 1e-30;
  options.parameter_tolerance = 1e-30;
  options.logging_type = ceres::SILENT;
  Log log;
  options.callbacks.push_back(&log);
  ceres::Solver::Summary summary;
  log.start = Now();
  ceres::Solve(options, &problem, &summary);
  std::printf("solve %.9f %.17g\n", Now() - log.start, summary.final_cost);
  return summary.IsSolutionUsable() ? 0 : 1;
}
