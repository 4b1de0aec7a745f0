// Threads that are kept: to start one takes some 15 us, to wake it less.
#include "threads.hpp"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>

#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace gridslam {
namespace {

class Pool {
 public:
  void run(int others, const std::function<void()>& work) {
    const std::unique_lock alone(busy_, std::try_to_lock);
    if (!alone) return work();
    {
      const std::lock_guard lock(mutex_);
      grow(others);
      work_ = &work, seats_ = std::min(others, workers_);
    }
    wake_.notify_all();
    work();
    std::unique_lock lock(mutex_);
    seats_ = 0;  // who comes later has nothing to do
    ended_.wait(lock, [&] { return running_ == 0; });
  }

 private:
  void grow(int others) {
    try {
      for (; workers_ < others; ++workers_) std::thread([this] { serve(); }).detach();
    } catch (const std::system_error&) {
      return;
    }
  }

  void serve() {
    std::unique_lock lock(mutex_);
    while (true) {
      wake_.wait(lock, [&] { return seats_ > 0; });
      --seats_, ++running_;
      lock.unlock();
      (*work_)();
      lock.lock();
      if (--running_ == 0) ended_.notify_one();
    }
  }

  std::mutex busy_, mutex_;
  std::condition_variable wake_, ended_;
  int workers_ = 0, seats_ = 0, running_ = 0;
  const std::function<void()>* work_ = nullptr;
};

std::atomic<Pool*> the_pool{nullptr};  // never destroyed: its threads end with the process

Pool& pool() {
#if defined(__unix__) || defined(__APPLE__)  // a fork leaves the threads behind
  static const int watched = pthread_atfork(nullptr, nullptr, [] { the_pool.store(nullptr); });
  static_cast<void>(watched);
#endif
  Pool* present = the_pool.load();
  if (present != nullptr) return *present;
  Pool* fresh = new Pool;
  if (the_pool.compare_exchange_strong(present, fresh)) return *fresh;
  delete fresh;
  return *present;
}

}  // namespace

void run_in_threads(int others, const std::function<void()>& work) { pool().run(others, work); }

}  // namespace gridslam
