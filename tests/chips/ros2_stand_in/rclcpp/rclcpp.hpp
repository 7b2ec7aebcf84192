// What the node uses of rclcpp, in one process and with a clock of its own. It reads lines from
// standard input in place of an executor and prints what is published:
//   temperature 23.5 | input/NAME 1.5 | wrench fx fy fz tx ty tz | step | wait SECONDS
#ifndef STAND_IN_RCLCPP_HPP
#define STAND_IN_RCLCPP_HPP
#include <chrono>
#include <cstdio>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>

#define RCLCPP_ERROR(logger, text) std::printf("error %s\n", text)

namespace stand_in {
inline double &clock() {
    static double seconds = 100.0;
    return seconds;
}
inline std::map<std::string, std::function<void(std::istream &)>> &topics() {
    static std::map<std::string, std::function<void(std::istream &)>> all;
    return all;
}
inline std::function<void()> &tick() {
    static std::function<void()> call;
    return call;
}
inline long long &period_us() {
    static long long period = 0;
    return period;
}
}  // namespace stand_in

namespace rclcpp {
struct Duration {
    double length;
    double seconds() const { return length; }
};
struct Time {
    double at = 0.0;
    Duration operator-(const Time &other) const { return {at - other.at}; }
    operator double() const { return at; }
};
template <typename Message>
struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    std::string topic;
    void publish(const Message &message) { std::cout << topic << ' ' << message << '\n'; }
};
template <typename Message>
struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription>;
};
struct TimerBase {
    using SharedPtr = std::shared_ptr<TimerBase>;
};
class Node {
public:
    explicit Node(const std::string &) {}
    template <typename Value>
    Value declare_parameter(const std::string &, Value value) {
        return value;
    }
    int get_logger() const { return 0; }
    Time now() const { return {stand_in::clock()}; }
    template <typename Message>
    typename Publisher<Message>::SharedPtr create_publisher(const std::string &topic, int) {
        auto made = std::make_shared<Publisher<Message>>();
        made->topic = topic;
        return made;
    }
    template <typename Message, typename Callback>
    typename Subscription<Message>::SharedPtr create_subscription(const std::string &topic, int,
                                                                  Callback callback) {
        stand_in::topics()[topic] = [callback](std::istream &line) {
            Message message;
            line >> message;
            callback(message);
        };
        return std::make_shared<Subscription<Message>>();
    }
    TimerBase::SharedPtr create_wall_timer(std::chrono::microseconds period,
                                           std::function<void()> call) {
        stand_in::period_us() = period.count();
        stand_in::tick() = call;
        return std::make_shared<TimerBase>();
    }
};
inline void init(int, char **) {}
inline void shutdown() {}
template <typename Kind>
void spin(std::shared_ptr<Kind>) {
    std::cout.precision(17);
    std::cout << "period_us " << stand_in::period_us() << '\n';
    std::string text;
    while (std::getline(std::cin, text)) {
        std::istringstream line(text);
        std::string word;
        line >> word;
        if (word == "step") {
            stand_in::clock() += static_cast<double>(stand_in::period_us()) * 1e-6;
            stand_in::tick()();
        } else if (word == "wait") {
            double seconds = 0.0;
            line >> seconds;
            stand_in::clock() += seconds;
        } else {
            stand_in::topics().at(word)(line);
        }
    }
}
}  // namespace rclcpp
#endif
